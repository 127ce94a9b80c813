"""What stands where in a Blender scene, at some frames: the scene is stepped through them, so whatever moves a thing counts
alike, a key, a parent, a constraint or the NLA.

What is read here holds nothing of Blender's, so it can be looked at in any thread.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..core.errors import UnisimError
from ..core.geometry import BoolArray, FloatArray
from ..core.world.drive import CameraModel
from .animation import keys_hide, scale_changes
from .cameras import model_of
from .clock import Clock
from .meshes import extent_of, file_of
from .meshes import model_of as model_of_mesh
from .poses import rigid
from .scaling import CHANGING, Scaling, scaling_of
from .things import KINDS_OF_DRIVE, sees_body, things, title_of

SetFrame = Callable[[int], object]


@dataclass(frozen=True)
class Thing:
    """An object of the drive at N frames: poses (N, 4, 4) in Blender's axes, whether it is there (N,); the rest as its properties
    have it. ``camera`` is a camera's intrinsics, ``index`` Blender's pass index, ``size_m`` (3,) how large it is drawn; ``mesh``
    is the file of the model that an actor's own surface is, whose middle the poses are of, and ``label`` its class. ``scaling``
    is how much larger it is drawn than it was imported; a mesh's scale is in its model. ``sees_body``: whether meshes that are
    the ego vehicle's body are visible to it. ``called`` is its name in the scenario where that is not ``name``. For the edits
    list alone: ``ridden`` are the poses (N, 4, 4) of its trajectory, ``span`` the frames of that one's first and last key,
    ``scale_lift_m`` how far it was lifted along its own axis for its scale."""

    name: str
    kind: str
    uid: str
    home: str
    look: str
    look_scene: str
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
        """What a scenario calls it where it has no id of the log's: the object's name, in a variant that in the first one."""
        return self.called or self.name

    @property
    def is_original(self) -> bool:
        """Whether it has the name that the import gave it."""
        return self.name == self.home


@dataclass(frozen=True)
class Sampled:
    """The things of a scene at the frames of ``clock``, in order of their names. ``items`` are the static items that were
    marked in the scene, by id, as their boxes have it in ``model``; a box may be gone."""

    name: str
    clock: Clock
    things: tuple[Thing, ...]
    items: dict[str, str] = field(default_factory=dict)

    def of(self, *kinds: str) -> Iterator[Thing]:
        """The things of some kinds."""
        return (thing for thing in self.things if thing.kind in kinds)


def frame_of(scene: bpy.types.Scene) -> float:
    """The frame that is shown, with its fraction."""
    return float(scene.frame_current + scene.frame_subframe)


@contextmanager
def kept_frame(scene: bpy.types.Scene) -> Iterator[None]:
    """Go back to the frame that was shown."""
    frame, part = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        scene.frame_set(frame, subframe=part)


def sample(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    clock: Clock,
    set_frame: SetFrame,
    also: Iterable[bpy.types.Object] = (),
) -> Sampled:
    """The scene's things at each frame of ``clock``. ``set_frame`` takes the depsgraph to a frame; ``also`` are cameras that are
    no part of the rig."""
    refuse_stretching(scene)
    found = [*things(scene, *KINDS_OF_DRIVE)]
    found += [thing for thing in also if thing not in found]
    shown = shown_names(depsgraph.view_layer_eval.layer_collection)
    # keys say when a thing is there; without keys, disabling it in viewports is a matter of the view alone
    keyed = [keys_hide(thing) for thing in found]
    matrices = np.empty((len(found), len(clock.frames), 4, 4))
    there = np.zeros((len(found), len(clock.frames)), bool)
    for at, frame in enumerate(clock.frames):
        set_frame(int(frame))
        for i, thing in enumerate(found):
            now = thing.evaluated_get(depsgraph)
            matrices[i, at] = now.matrix_world
            there[i, at] = not (now.hide_viewport and keyed[i]) and not now.hide_render and thing.name in shown
    poses = rigid(matrices)
    scalings = [_scaling(thing, matrices[i], poses[i], there[i]) for i, thing in enumerate(found)]
    size = picture_size(scene.render)
    extents = [
        tuple((extent_of(thing) * np.array(scaling.factors)).tolist()) for thing, scaling in zip(found, scalings, strict=True)
    ]
    files = [""] * len(found)
    for i, thing in enumerate(found):
        if thing.unisim.mesh and there[i].any():
            model, middle = model_of_mesh(thing, depsgraph)
            poses[i, :, :3, 3] += poses[i, :, :3, :3] @ middle
            extents[i], files[i] = tuple(model.size_m.tolist()), str(file_of(model))
    return Sampled(
        scene.name,
        clock,
        tuple(
            Thing(
                name=thing.name,
                kind=thing.unisim.kind,
                uid=thing.unisim.uid,
                home=thing.unisim.home,
                look=thing.unisim.look,
                look_scene=bpy.path.abspath(thing.unisim.look_scene) if thing.unisim.look_scene else "",
                model=thing.unisim.model,
                index=thing.pass_index,
                poses=poses[i],
                there=there[i],
                camera=model_of(thing, size) if thing.type == "CAMERA" else None,
                size_m=extents[i],
                mesh=files[i],
                label=thing.unisim.label,
                scaling=scalings[i],
                called=title_of(thing),
                sees_body=sees_body(thing),
            )
            for i, thing in enumerate(found)
        ),
        {item.name: item.model for item in scene.unisim.static_items},
    )


def refuse_stretching(scene: bpy.types.Scene) -> None:
    """Raise `UnisimError` where a scene's frames are not the log's."""
    render = scene.render
    if render.frame_map_old != render.frame_map_new:
        raise UnisimError(
            f'scene "{scene.name}": Output > Frame Range > Time Stretching takes frame {render.frame_map_old} to '
            f"{render.frame_map_new}, so its frames are not the log's: set both alike, and retime actors instead"
        )


def _scaling(thing: bpy.types.Object, matrices: FloatArray, poses: FloatArray, there: BoolArray) -> Scaling:
    scaling = Scaling() if thing.unisim.mesh else scaling_of(matrices, poses, there)
    # keys tell it whichever frames are looked at
    return Scaling(scaling.factors, CHANGING) if not scaling.fault and scale_changes(thing) else scaling


def picture_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Width and height of a picture, in pixels."""
    percent = render.resolution_percentage
    return render.resolution_x * percent // 100, render.resolution_y * percent // 100


def sample_all(scene: bpy.types.Scene, clock: Clock) -> Sampled:
    """The scene's things at all of the clock's frames; the frame that is shown stays."""
    with kept_frame(scene):
        return sample(scene, depsgraph_of(scene), clock, scene.frame_set)


def depsgraph_of(scene: bpy.types.Scene) -> bpy.types.Depsgraph:
    """Return a scene's depsgraph, made where no window shows the scene."""
    if scene == bpy.context.scene:
        return bpy.context.evaluated_depsgraph_get()
    scene.frame_set(scene.frame_current)
    return scene.view_layers[0].depsgraph


def shown_names(layer: bpy.types.LayerCollection) -> set[str]:
    """Names of the objects in some collection that is neither excluded nor hidden for renders."""
    if layer.exclude or layer.collection.hide_render:
        return set()
    names = {thing.name for thing in layer.collection.objects}
    return names.union(*(shown_names(child) for child in layer.children))
