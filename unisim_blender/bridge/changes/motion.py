"""Trajectories changed as keyframes: displaced, put elsewhere, shifted along their path, at other times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import bpy
import numpy as np

from ...core.geometry import FloatArray, matrix_from_quaternion, quaternion_from_matrix
from ...core.scenario.motion.paths import is_path
from ...core.world.drive import Drive
from ...editing.edits.lines import metres
from ...editing.motion.braking import Approach, TimeChange, changed_keys
from ...editing.motion.keys import TrajectoryKeys, along_line, shifted_keys
from ...editing.motion.retiming import later_or_earlier
from ...editing.sampled.axes import axes_of
from ...editing.sampled.clock import Clock
from ...editing.texts import Text, series
from ..objects.animation import FRAMES, VALUES, change_keys, curves_of, keys_of, write_keys
from ..objects.imported import class_of
from ..objects.meshes import size_of
from ..objects.trajectories import keyed_pose, own_trajectory, ride, settle_on, trajectory_of

MIN_SHIFT = 1e-6
"""Smaller shifts, in metres or seconds, are none."""


def displaced_along(obj: bpy.types.Object, offset_m: Sequence[float]) -> None:
    """Move an object along its own axes by ``offset_m`` (3,), alike at every frame."""
    offset = np.array(offset_m, float)
    paths = {curve.data_path for curve in curves_of(obj)}
    if "rotation_quaternion" not in paths:  # its keys keep their interpolation: all of them move alike
        apart = matrix_from_quaternion(np.array(obj.matrix_basis.to_quaternion(), float)) @ offset
        obj.location = np.array(obj.location) + apart
        if "location" not in paths:
            obj.unisim.rest_location = obj.location  # auto-keying keys what people move by hand alone
        for curve in curves_of(obj):
            if curve.data_path == "location":
                change_keys(curve, VALUES, partial(np.add, apart[curve.array_index]))
        return
    keys = keys_of(obj)
    assert keys is not None  # it has keys of its rotation
    frames, positions, quaternions = keys
    write_keys(obj, frames, positions + matrix_from_quaternion(quaternions) @ offset, quaternions)


def displaced_beside(obj: bpy.types.Object, offset_m: Sequence[float], drive: Drive) -> None:
    """Move an actor by ``offset_m`` (3,), forward, left and up in the axes of `axes_of`, alike at every frame."""
    now = keyed_pose(obj, float(drive.frames[0]))
    axes = axes_of(class_of(obj, drive), now[:3, 3], drive)
    displaced_along(obj, offset_m if axes is None else (now[:3, :3].T @ axes @ np.array(offset_m)).tolist())


def moved_to(obj: bpy.types.Object, place: Sequence[float], frame: float) -> None:
    """Move an object's whole trajectory, in the ground's plane, so that it is at ``place`` at a frame.
    Its height stays."""
    now = keyed_pose(obj, frame)[:3, 3]
    apart = np.array([place[0] - now[0], place[1] - now[1], 0.0])
    above = own_trajectory(obj) or obj
    keys = keys_of(above)
    if keys is None:
        above.location = np.array(above.location) + apart
        return
    frames, positions, quaternions = keys
    write_keys(above, frames, positions + apart, quaternions)


def follow(obj: bpy.types.Object, line: FloatArray, start_s: float, way: Approach, clock: Clock) -> None:
    """Put an object on a trajectory along a line (P, 3) from a time of the log on, its front ahead and its
    underside on the line. At the line's end it stands."""
    times = np.append(np.arange(0.0, way.duration_s, 1 / clock.rate), way.duration_s + np.array([0.0, 1 / clock.rate]))
    _, positions, quaternions = along_line(line, way.lengths(times), float(size_of(obj)[2]))
    above = own_trajectory(obj) or ride(obj)
    settle_on(obj)
    write_keys(above, clock.frame(start_s + times), positions, quaternions)


def move_along(obj: bpy.types.Object, poses: FloatArray, clock: Clock) -> None:
    """Put an object on a trajectory of poses (N, 4, 4) at the clock's frames."""
    write_keys(ride(obj), clock.frames, poses[:, :3, 3], quaternion_from_matrix(poses[:, :3, :3]))


def retimed(obj: bpy.types.Object, at: Callable[[FloatArray], FloatArray]) -> None:
    """Move the keys of an object, and of its presence, to ``at`` their frames, which rises."""
    above = own_trajectory(obj)
    for curve in (*curves_of(obj), *(curves_of(above) if above is not None else ())):
        change_keys(curve, FRAMES, at)


def respeeded(
    obj: bpy.types.Object, change_of: Callable[[TrajectoryKeys], TimeChange], clock: Clock
) -> TimeChange | None:
    """Let an object be on its trajectory at other times, those of a change of its keys; None where it has no keys."""
    above = own_trajectory(obj) or obj
    keys = keys_of(above)
    if keys is None:
        return None
    change = change_of(TrajectoryKeys(*keys))

    def later(frames: FloatArray) -> FloatArray:
        return clock.frame(change.later(clock.time_s(frames)))

    for curve in curves_of(obj):
        if above is not obj or curve.data_path == "hide_viewport":  # what displaces it from its trajectory goes along
            change_keys(curve, FRAMES, later)
    write_keys(above, *changed_keys(TrajectoryKeys(*keys), change, clock))
    return change


def shift(obj: bpy.types.Object, left_m: float, ahead_m: float, later_s: float, drive: Drive) -> str:
    """Shift an actor, alike at every time, and return what was done as a sentence.

    ``left_m`` is along its own y axis, ``ahead_m`` an arc length along the path of its trajectory, straight on beyond the
    path's ends, or along the x axis of an actor that goes nowhere. Axes of what has no front are those of `axes_of`.
    ``later_s`` is in seconds of the log and takes its presence along.
    """
    done: list[str] = []
    clock = Clock.of(drive)
    if abs(left_m) > MIN_SHIFT:
        displaced_beside(obj, (0.0, left_m, 0.0), drive)
        done.append(Text("{length} to the left" if left_m > 0 else "{length} to the right", length=metres(abs(left_m))))
    if abs(ahead_m) > MIN_SHIFT:
        shift = Text("{length} forward" if ahead_m > 0 else "{length} backward", length=metres(abs(ahead_m)))
        if _along_path(obj, ahead_m, clock):
            done.append(Text("{shift} along its path", shift=shift))
        else:
            displaced_beside(obj, (ahead_m, 0.0, 0.0), drive)
            done.append(Text("{shift} (it stands still)", shift=shift))
    if abs(later_s) > MIN_SHIFT:
        if trajectory_of(obj) is None and not len(curves_of(obj)):
            done.append(Text("at the same times, as it stands there throughout"))
        else:
            retimed(obj, lambda frames: clock.frame(clock.time_s(frames) + later_s))
            done.append(later_or_earlier(later_s, clock))
    return series([obj.name, series(done)], ": ") if done else ""


def _along_path(obj: bpy.types.Object, ahead_m: float, clock: Clock) -> bool:
    """Shift the keys of an actor's trajectory along their path; return whether there is one."""
    above = trajectory_of(obj) or obj
    keys = keys_of(above)
    if keys is None or not is_path(keys[1]):
        return False
    above = own_trajectory(obj) or obj
    write_keys(above, *shifted_keys(*keys, clock.frames, ahead_m))
    return True
