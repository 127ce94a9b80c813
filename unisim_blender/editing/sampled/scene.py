"""Objects of a scene at some frames as plain data: no Blender here, so it can be read in any thread. How large an
object is drawn is its `Scaling`, with what of a scale sensors could not be shown.

World, ego and actor boxes have the same axes in core and Blender. A Blender camera looks along -z with y up; core's
cameras look along z with y down.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ...core.geometry import BoolArray, FloatArray, nearest_rotation
from ...core.scenario.edits.scale import SIZE_FACTOR_BOUNDS, scales
from ...core.scenario.light import LightSpec
from ...core.scenario.weather import WeatherSpec
from ...core.world.drive import Actor, CameraModel, Drive
from ..texts import Text
from .clock import Clock, recorded_poses, recorded_there

BLENDER_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Also its own inverse."""
SAME_M, SAME_RAD = 1e-4, 1e-5
"""Within these an object stands where it was imported."""
NEAR_M, NEAR_RAD = 2e-3, 1e-3
"""Within these it is where keys that were delayed put it."""
FLOAT32_ULP = 2.0**-23


def rigid(matrices: FloatArray) -> FloatArray:
    """Blender's matrices (..., 4, 4) as rigid poses: scale and shear are taken away."""
    poses = np.array(matrices, np.float64)
    axes = poses[..., :3, :3] / np.maximum(np.linalg.norm(poses[..., :3, :3], axis=-2, keepdims=True), 1e-12)
    # float32 axes are orthogonal to 1e-7 only; the nearest rotation is what is meant
    poses[..., :3, :3] = nearest_rotation(axes)
    return poses


def optical(poses: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) of cameras: Blender's from core's, and the other way round."""
    return poses @ BLENDER_FROM_OPTICAL


def same(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return which poses (..., 4, 4) agree to `SAME_M` and `SAME_RAD`, and to Blender's float32: (...) bool."""
    return same_place(a, b) & same_turn(a, b)


def differ(poses: FloatArray, there: BoolArray, others: FloatArray, others_there: BoolArray) -> bool:
    """Return whether poses (N, 4, 4) that count where they are present (N,) are not the `same` as others, or at other
    frames."""
    return bool((there != others_there).any() or not same(poses, others)[others_there].all())


def differs(poses: FloatArray, there: BoolArray, actor: Actor, drive: Drive, clock: Clock) -> bool:
    """Return whether an actor at poses (N, 4, 4), present (N,), goes elsewhere or at other times than recorded."""
    return differ(poses, there, recorded_poses(actor, clock), recorded_there(actor, drive, clock))


def same_place(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return which positions of poses (..., 4, 4) agree: (...) bool."""
    away = np.linalg.norm(a[..., :3, 3] - b[..., :3, 3], axis=-1)
    return np.asarray(away <= SAME_M + 4 * FLOAT32_ULP * np.abs(b[..., :3, 3]).max(-1))


def near(a: FloatArray, b: FloatArray, times: float = 1.0) -> BoolArray:
    """Return which poses (N, 4, 4) agree as far as keys that were delayed do, where the log's frames are not quite evenly
    spaced, or a number of ``times`` less: (N,) bool."""
    away = np.linalg.norm((a - b)[:, :3, 3], axis=-1)
    return np.asarray((away < times * NEAR_M) & (np.abs((a - b)[:, :3, :3]).max((1, 2)) < times * NEAR_RAD))


def same_turn(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return which rotations of poses (..., 4, 4) agree: (...) bool. A turn by a small angle moves axes by sqrt(2)
    times it in all."""
    turn = np.linalg.norm(a[..., :3, :3] - b[..., :3, :3], axis=(-2, -1)) / np.sqrt(2)
    return np.asarray(turn <= SAME_RAD)


SAME_SCALE = 1e-4
"""Within this of 1 an object is as large as it was imported: half a millimetre of a car."""
SAME_SHAPE = 1e-3
"""Axes that lean by less are at right angles, and factors that differ by less are the same throughout."""
DIGITS = 5
"""Of factors: what is drawn in Blender's float32 gives the same ones at every frame."""
MIRRORED, SHEARED, CHANGING = "mirrored", "sheared", "changing"
Factors = tuple[float, float, float]
UNIT: Factors = (1.0, 1.0, 1.0)
WHY = {
    MIRRORED: Text(
        "is mirrored by a negative scale, which cannot be rendered: make its scale, and that of its parent, positive"
    ),
    SHEARED: Text(
        "is sheared by the scale of its parent, which cannot be rendered: clear the parent's scale, or scale it alike "
        "along all axes"
    ),
    CHANGING: Text(
        "has a scale that changes over time, which cannot be rendered: delete the keys of its scale, and what else animates it"
    ),
}


class Scaling(NamedTuple):
    """``factors`` (3,) of an object along its own axes, 1 where it is as large as imported; ``fault`` is why sensors
    cannot be shown it so, a key of `WHY`, or ""."""

    factors: Factors = UNIT
    fault: str = ""


@dataclass(frozen=True)
class SampledObject:
    """An object of the drive at N frames: poses (N, 4, 4) in Blender's axes, whether it is there (N,); the rest as its
    properties have it. ``camera`` is a camera's intrinsics, ``index`` Blender's pass index, ``size_m`` (3,) how large
    it is drawn; ``mesh`` is the file of the model that an actor's own surface is, whose middle the poses are of, and
    ``label`` its class. ``scaling`` is how much larger it is drawn than it was imported; a mesh's scale is in its
    model. ``sees_body``: whether meshes that are the ego vehicle's body are visible to it. ``called`` is its name in
    the scenario where that is not ``name``; ``span`` are the frames of its trajectory's first and last key,
    ``maneuvers`` those that it notes, as JSON, and ``row`` the edit `row` that put it there. For the edits list alone:
    ``ridden`` are the poses (N, 4, 4) of its trajectory, ``scale_lift_m`` how far it was lifted along its own axis for
    its scale. ``walked_m`` is the length of its path up to the first frame, where limbs follow that."""

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
    row: str = ""
    maneuvers: str = ""
    scale_lift_m: float = 0.0
    walked_m: float = 0.0

    @property
    def title(self) -> str:
        """Name in a scenario where it has no id of the log's: the object's name, in a variant that
        in the first one."""
        return self.called or self.name

    @property
    def is_original(self) -> bool:
        """Whether it has the name that the import gave it."""
        return self.name == self.original_name


class LampSetting(NamedTuple):
    """A lamp of an actor, by their names in a scenario, that is set to a state from one frame to another, which are infinite
    where no key comes before or after."""

    actor: str
    lamp: str
    state: str
    first: float
    end: float


@dataclass(frozen=True)
class Sampled:
    """The objects of a scene at the frames of ``clock``, in order of their names. ``items`` are the static items that
    were marked in the scene, by id, as their boxes have it in ``model``; a box may be gone. ``skipped`` are the recorded
    sensors that were not imported, ``weather`` and ``light`` are those of the whole drive."""

    name: str
    clock: Clock
    objects: tuple[SampledObject, ...]
    items: dict[str, str] = field(default_factory=dict)
    skipped: frozenset[str] = frozenset()
    weather: WeatherSpec | None = None
    light: LightSpec | None = None
    lamps: tuple[LampSetting, ...] = ()

    def of(self, *kinds: str) -> Iterator[SampledObject]:
        """The objects of some kinds."""
        return (obj for obj in self.objects if obj.kind in kinds)


def scaling_of(matrices: FloatArray, poses: FloatArray, there: BoolArray | None = None) -> Scaling:
    """Return the scaling of one object over N frames, from Blender's matrices and the rigid poses of these (N, 4, 4);
    frames at which it is not ``there`` (N,) do not count."""
    some = slice(None) if there is None or not there.any() else there
    drawn, turned = np.asarray(matrices, np.float64)[some, :3, :3], poses[some, :3, :3]
    along = np.swapaxes(turned, -1, -2) @ drawn
    each = np.linalg.norm(drawn, axis=-2)
    x, y, z = np.round(each.mean(0), DIGITS).tolist()
    factors = tuple(1.0 if abs(factor - 1) < SAME_SCALE else factor for factor in (x, y, z))
    fault = ""
    if (np.linalg.det(drawn) < 0).any():
        fault = MIRRORED
    elif (np.abs(along - along * np.eye(3)).max((-2, -1)) > SAME_SHAPE * each.max(-1)).any():
        fault = SHEARED
    elif (np.ptp(each, axis=0) > SAME_SHAPE * each.mean(0)).any():
        fault = CHANGING
    return Scaling((factors[0], factors[1], factors[2]), fault)


def refusal(name: str, scaling: Scaling) -> str:
    """Return why an actor cannot be rendered with a scaling, as a sentence that names it; "" where it can."""
    if scaling.fault:
        return Text('object "{name}": {why}', name=name, why=WHY[scaling.fault])
    if not scales(scaling.factors):
        return Text(
            'object "{name}": is scaled by {factors}; along each axis an actor can be scaled by {least:g} to {most:g}',
            name=name, factors=scale_text(scaling.factors), least=SIZE_FACTOR_BOUNDS[0], most=SIZE_FACTOR_BOUNDS[1],
        )  # fmt: skip
    return ""


def scale_text(factors: Sequence[float]) -> str:
    """Return factors in words: one number where they are alike."""
    texts = [f"{factor:.3g}" for factor in factors]
    return texts[0] if len(set(texts)) == 1 else " x ".join(texts)


def size_text(size_m: Sequence[float] | FloatArray, digits: int = 1) -> str:
    """Return a box's edges in words."""
    return " x ".join(f"{edge:.{digits}f}" for edge in size_m) + " m"
