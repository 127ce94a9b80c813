"""The scene about the frame that is shown, without leaving it: the viewport must not change frames.

Where an object is now is known; where it is a frame earlier and later follows from its own and its parents' keys. What
anything else moves (a constraint, a driver, the NLA) is evaluated in another scene beside this one, which holds those
objects alone and is thrown away at once. That scene is in no window, so Blender writes nothing of it back: what is
shown, and changes without a key, stay. Making it is not allowed while a view is drawn, so the viewport has it
done by a timer.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...core.geometry import BoolArray, FloatArray
from ...core.world.classes import motion_of
from ...core.world.drive import Drive
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import Sampled, SampledObject, rigid, scaling_of
from ..objects.animation import curves_of, keys_hide, shown_by_keys
from ..objects.imported import KINDS_OF_DRIVE, imported_objects
from ..objects.trajectories import keyed_pose, keyed_poses
from ..window import redraw, run_soon
from .stepping import frame_of, sample

BESIDE_SCENE = "UniSim beside"
RETRY_S = 0.2
"""Until the next try, while an image is rendered."""


@dataclass(frozen=True)
class Stepped:
    """An object's poses now (4, 4) and at N frames (N, 4, 4), whether it is there (N,), and what is wrong with its
    scale then, as they were evaluated."""

    now: FloatArray
    poses: FloatArray
    there: BoolArray
    fault: str


AdjacentTimes = tuple[float, tuple[float, ...]]
"""The frame that is shown, and those about it."""

_stepped: dict[str, tuple[AdjacentTimes, dict[str, Stepped]]] = {}
"""By scene: its newest moment, and objects by name."""
_asked: dict[str, tuple[Clock, tuple[str, ...]]] = {}
"""Moments that the timer is to evaluate, by scene; names of objects beside the drive's own."""


def sample_now(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, clock: Clock, also: tuple[bpy.types.Object, ...] = ()
) -> Sampled:
    """The scene's objects at the frames of ``clock``, which the frame that is shown is about. Of what is `lacking`,
    keys alone count."""
    now = frame_of(scene)
    here = Clock(np.array([now, now + 1.0]), clock.time_s(np.array([now, now + 1.0])))
    current = sample(scene, depsgraph, here, lambda frame: None, also)
    stepped = _known(scene, clock)
    sampled = []
    for obj in current.objects:
        owner = scene.objects.get(obj.name) or next(other for other in also if other.name == obj.name)
        scaling = obj.scaling
        if obj.name in stepped:
            if not obj.mesh and not scaling.fault:
                scaling = scaling._replace(fault=stepped[obj.name].fault)
            poses, there = stepped[obj.name].poses, stepped[obj.name].there
            if obj.there[0]:  # displaced as the pose now is by a change without a key; hidden objects are not evaluated
                poses = obj.poses[0] @ np.linalg.inv(stepped[obj.name].now) @ poses
        else:
            poses = obj.poses[0] @ np.linalg.inv(keyed_pose(owner, now)) @ keyed_poses(owner, clock.frames)
            keyed = any(curve.data_path == "hide_viewport" for curve in curves_of(owner))
            there = shown_by_keys(owner, clock.frames) if keyed else np.repeat(obj.there[:1], len(clock.frames))
        sampled.append(replace(obj, poses=rigid(poses), there=there & (not owner.hide_render), scaling=scaling))
    return replace(current, clock=clock, objects=tuple(sampled))


def with_lengths(sampled: Sampled, scene: bpy.types.Scene, drive: Drive) -> Sampled:
    """Return a scene sampled at a few frames with the lengths of paths up to the first of them (`SampledObject.walked_m`), of
    actors that change their shape as they go and that keys alone move."""
    before = Clock.of(drive).frames
    before = before[before <= sampled.clock.frames[0]]

    def with_length(obj: SampledObject) -> SampledObject:
        actor, owner = drive.actors.get(obj.appearance or obj.uid), scene.objects.get(obj.name)
        if obj.kind != "ACTOR" or actor is None or owner is None or motion_of(actor.label) != "deforming":
            return obj
        if obj.mesh or not moved_by_keys(owner):
            return obj
        path = keyed_poses(owner, before)[shown_by_keys(owner, before), :2, 3]
        return replace(obj, walked_m=float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()))

    return replace(sampled, objects=tuple(map(with_length, sampled.objects)))


def lacking(scene: bpy.types.Scene, clock: Clock, also: Iterable[bpy.types.Object] = ()) -> list[bpy.types.Object]:
    """Objects that keys alone do not tell of, and that were not evaluated about this moment yet."""
    known = _known(scene, clock)
    objects = {obj.name: obj for obj in (*imported_objects(scene, *KINDS_OF_DRIVE), *also)}
    return [obj for name, obj in objects.items() if name not in known and not moved_by_keys(obj)]


def step_beside(scene: bpy.types.Scene, clock: Clock, moved: Sequence[bpy.types.Object]) -> bool:
    """Evaluate some objects at the frames of ``clock``, for `sample_now`; False where that has to wait for
    a render to end.

    Not to be called while anything is drawn.
    """
    if not moved:
        return True
    if bpy.app.is_job_running("RENDER"):
        return False
    now = frame_of(scene)
    matrices, hidden, _ = evaluate_beside((now, *clock.frames), moved)
    there = ~hidden
    poses = rigid(matrices)
    new = {
        obj.name: Stepped(
            poses[0, i], poses[1:, i], there[1:, i], scaling_of(matrices[1:, i], poses[1:, i], there[1:, i]).fault
        )
        for i, obj in enumerate(moved)
    }
    _stepped[scene.name] = (now, tuple(clock.frames)), _known(scene, clock) | new
    return True


def evaluate_beside(
    frames: Sequence[float], moved: Sequence[bpy.types.Object]
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Evaluate objects at N frames in a scene beside, which is thrown away: their matrices in the world (N, T, 4, 4),
    whether keys hide them in views, and whether they are hidden for renders (N, T)."""
    matrices = np.empty((len(frames), len(moved), 4, 4))
    hidden, left_out = np.empty((2, len(frames), len(moved)), bool)
    hides = [keys_hide(obj) for obj in moved]
    beside = bpy.data.scenes.new(BESIDE_SCENE)
    try:
        beside.frame_set(int(frames[0]))  # makes its depsgraph; the frame handlers that this calls find an empty scene
        depsgraph = beside.view_layers[0].depsgraph
        for obj in moved:
            beside.collection.objects.link(obj)
        for at, frame in enumerate(frames):
            beside.frame_current, beside.frame_subframe = int(np.floor(frame)), float(frame - np.floor(frame))
            depsgraph.update()
            for i, obj in enumerate(moved):
                now = obj.evaluated_get(depsgraph)
                matrices[at, i] = now.matrix_world
                hidden[at, i], left_out[at, i] = hides[i] and now.hide_viewport, now.hide_render
    finally:
        bpy.data.scenes.remove(beside)
    return matrices, hidden, left_out


def step_soon(scene: bpy.types.Scene, clock: Clock, also: Iterable[bpy.types.Object] = ()) -> None:
    """Have a timer evaluate what is `lacking`, and the views drawn again then."""
    _asked[scene.name] = clock, tuple(obj.name for obj in also)
    run_soon(_step_asked)


def _step_asked() -> float | None:
    for name, (clock, others) in list(_asked.items()):
        scene = bpy.data.scenes.get(name)
        also = [bpy.data.objects[other] for other in others if other in bpy.data.objects]
        if scene is not None and not step_beside(scene, clock, lacking(scene, clock, also)):
            return RETRY_S
        del _asked[name]
    redraw("VIEW_3D")
    return None


def moved_by_keys(obj: bpy.types.Object) -> bool:
    """Whether nothing but its own and its parents' keys moves an object."""
    data = obj.animation_data
    plain = (
        (data is None or not (data.drivers or (data.use_nla and any(track.strips for track in data.nla_tracks))))
        and all(constraint.mute for constraint in obj.constraints)
        and obj.rotation_mode != "AXIS_ANGLE"
        and not any((*obj.delta_location, *obj.delta_rotation_euler, *obj.delta_rotation_quaternion[1:]))
    )
    if not plain or obj.parent is None:
        return plain
    return obj.parent_type == "OBJECT" and tuple(obj.parent.scale) == (1.0, 1.0, 1.0) and moved_by_keys(obj.parent)


def _known(scene: bpy.types.Scene, clock: Clock) -> dict[str, Stepped]:
    moment, stepped = _stepped.get(scene.name, (None, {}))
    return stepped if moment == (frame_of(scene), tuple(clock.frames)) else {}


@persistent
def forget_moved(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Forget a scene's moment when anything in it moved. That a scene beside came and went moves nothing."""
    if (
        scene.name in _stepped
        and depsgraph is not None
        and any(update.is_updated_transform for update in depsgraph.updates)
    ):
        del _stepped[scene.name]


@persistent
def forget_all(*_: object) -> None:
    """Forget every moment: another file, or another state of it."""
    _stepped.clear()


HANDLERS = (
    ("depsgraph_update_post", forget_moved),
    *((name, forget_all) for name in ("load_post", "undo_post", "redo_post")),
)
TIMERS = (_step_asked,)


def unregister() -> None:
    """Forget every moment."""
    _stepped.clear()
    _asked.clear()
