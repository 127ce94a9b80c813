"""Handles on a trajectory: the times at which an actor can be displaced by hand, and what displacing it there means.

A change at one time blends in and out over `BLEND_S` on both sides, as a change with auto-keying does.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.geometry import FloatArray
from ...editing.actors.table import present_span
from ...editing.motion.keys import BLEND_S, Handle, handle_times
from ...editing.sampled.clock import Clock
from ..objects.animation import curves_of, shown_by_keys
from ..objects.trajectories import keyed_pose, trajectory_of

FRAME_TOLERANCE = 0.02
PLACE, TURNS = "location", ("rotation_quaternion", "rotation_euler", "rotation_axis_angle")
PATHS = (PLACE, "rotation_quaternion", "hide_viewport")
"""Properties whose keys dragging changes."""
PARTS = ("co", "handle_left", "handle_right")


def handles_of(obj: bpy.types.Object, clock: Clock) -> list[Handle]:
    """Return the handles of an object that rides on a trajectory, in order of time; none where it rides on none.

    There is one at each key of its displacement and at whole seconds, while the object is present.
    """
    span = present_span(shown_by_keys(obj, clock.frames), clock)
    if trajectory_of(obj) is None or span is None:
        return []
    times = handle_times(clock.time_s(_key_frames(obj)), span)
    frames = clock.frame(np.array([time for time, _ in times]))
    return [
        Handle(time, keyed_pose(obj, float(frame))[:3, 3], is_key)
        for (time, is_key), frame in zip(times, frames, strict=True)
    ]


def displace_at(obj: bpy.types.Object, time_s: float, offset_m: FloatArray, clock: Clock) -> None:
    """Displace an object at a time by an offset (3,) in the world, and less and less up to `BLEND_S`
    before and after it.

    Keys within that span stay, and the change ends at the nearest of them. Raises `ValueError` where it rides
    on no trajectory.
    """
    above = trajectory_of(obj)
    if above is None:
        raise ValueError(f"{obj.name}: rides on no trajectory")
    first, frame, last = (float(f) for f in clock.frame(np.array([time_s - BLEND_S, time_s, time_s + BLEND_S])))
    axes = (keyed_pose(above, frame) @ np.array(obj.matrix_parent_inverse, float))[:3, :3]
    apart = axes.T @ np.asarray(offset_m, float)
    for index in range(3):
        if _curve(obj, index) is None:
            obj.keyframe_insert(PLACE, index=index, frame=frame)
        curve = _curve(obj, index)
        assert curve is not None  # it was there, or the key made it
        frames = [float(key.co[0]) for key in curve.keyframe_points]
        ends = [
            end
            for end, low, high in ((first, first, frame), (last, frame, last))
            if not any(
                low - FRAME_TOLERANCE <= f <= high + FRAME_TOLERANCE and abs(f - frame) > FRAME_TOLERANCE
                for f in frames
            )
        ]
        values = [curve.evaluate(f) for f in (*ends, frame)]
        values[-1] += float(apart[index])
        for at, value in zip((*ends, _nearest(frames, frame)), values, strict=True):
            key = curve.keyframe_points.insert(at, value, options={"FAST"})
            key.interpolation = "BEZIER"
            key.handle_left_type = key.handle_right_type = "AUTO_CLAMPED"
        curve.update()


def _nearest(frames: list[float], frame: float) -> float:
    """The frame of a key that is at ``frame`` but for rounding, else that frame."""
    return next((f for f in frames if abs(f - frame) <= FRAME_TOLERANCE), frame)


def _curve(obj: bpy.types.Object, index: int) -> bpy.types.FCurve | None:
    return next((c for c in curves_of(obj) if c.data_path == PLACE and c.array_index == index), None)


def _key_frames(obj: bpy.types.Object) -> FloatArray:
    return np.array([key.co[0] for c in curves_of(obj) if c.data_path == PLACE for key in c.keyframe_points], float)


@dataclass(frozen=True)
class _Keys:
    """A curve's keys as arrays, and how they are interpolated and handled."""

    numbers: dict[str, NDArray[np.float32]]
    kinds: list[tuple[str, str, str]]


@dataclass
class TransformSnapshot:
    """Location, rotation and keys of an object before it was dragged: `restore` puts it back."""

    numbers: dict[str, tuple[float, ...]]
    had_data: bool
    curves: dict[tuple[str, int], _Keys] = field(default_factory=dict)

    @staticmethod
    def of(obj: bpy.types.Object) -> TransformSnapshot:
        """Keep an object's location and rotation."""
        snapshot = TransformSnapshot(
            {path: tuple(getattr(obj, path)) for path in (PLACE, *TURNS)}, obj.animation_data is not None
        )
        for curve in curves_of(obj):
            if curve.data_path in PATHS:
                parts = {part: np.empty(2 * len(curve.keyframe_points), np.float32) for part in PARTS}
                for part, values in parts.items():
                    curve.keyframe_points.foreach_get(part, values)
                kinds = [(k.interpolation, k.handle_left_type, k.handle_right_type) for k in curve.keyframe_points]
                snapshot.curves[curve.data_path, curve.array_index] = _Keys(parts, kinds)
        return snapshot

    def restore(self, obj: bpy.types.Object) -> None:
        """Put an object back where it stood."""
        for path, numbers in self.numbers.items():
            setattr(obj, path, numbers)
        for curve in [curve for curve in curves_of(obj) if curve.data_path in PATHS]:
            keys = self.curves.get((curve.data_path, curve.array_index))
            if keys is None:
                curves_of(obj).remove(curve)  # type: ignore[union-attr]
                continue
            curve.keyframe_points.clear()
            curve.keyframe_points.add(len(keys.kinds))
            for part, values in keys.numbers.items():
                curve.keyframe_points.foreach_set(part, values)
            for key, kinds in zip(curve.keyframe_points, keys.kinds, strict=True):
                key.interpolation, key.handle_left_type, key.handle_right_type = kinds
            curve.update()
        if not self.had_data and obj.animation_data is not None and not len(curves_of(obj)):
            obj.animation_data_clear()
