"""What stands where in a scene at some frames, as plain data: no Blender here, so it can be read in any thread."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from ...core.geometry import BoolArray, FloatArray
from ...core.world.drive import CameraModel
from .clock import Clock
from .scaling import Scaling


@dataclass(frozen=True)
class SampledObject:
    """An object of the drive at N frames: poses (N, 4, 4) in Blender's axes, whether it is there (N,); the rest as its
    properties have it. ``camera`` is a camera's intrinsics, ``index`` Blender's pass index, ``size_m`` (3,) how large
    it is drawn; ``mesh`` is the file of the model that an actor's own surface is, whose middle the poses are of, and
    ``label`` its class. ``scaling`` is how much larger it is drawn than it was imported; a mesh's scale is in its
    model. ``sees_body``: whether meshes that are the ego vehicle's body are visible to it. ``called`` is its name in
    the scenario where that is not ``name``. For the edits list alone: ``ridden`` are the poses (N, 4, 4) of its
    trajectory, ``span`` the frames of that one's first and last key, ``scale_lift_m`` how far it was lifted along its
    own axis for its scale."""

    name: str
    kind: str
    uid: str
    original_name: str
    appearance: str
    appearance_scene: str
    model: str
    index: int
    poses: FloatArray
    there: BoolArray
    camera: CameraModel | None = None
    size_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    mesh: str = ""
    label: str = ""
    scaling: Scaling = Scaling()
    sees_body: bool = True
    called: str = ""
    ridden: FloatArray | None = None
    span: tuple[float, float] | None = None
    scale_lift_m: float = 0.0

    @property
    def title(self) -> str:
        """What a scenario calls it where it has no id of the log's: the object's name, in a variant that
        in the first one."""
        return self.called or self.name

    @property
    def is_original(self) -> bool:
        """Whether it has the name that the import gave it."""
        return self.name == self.original_name


@dataclass(frozen=True)
class Sampled:
    """The objects of a scene at the frames of ``clock``, in order of their names. ``items`` are the static items that
    were marked in the scene, by id, as their boxes have it in ``model``; a box may be gone."""

    name: str
    clock: Clock
    objects: tuple[SampledObject, ...]
    items: dict[str, str] = field(default_factory=dict)

    def of(self, *kinds: str) -> Iterator[SampledObject]:
        """The objects of some kinds."""
        return (obj for obj in self.objects if obj.kind in kinds)
