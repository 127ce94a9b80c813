"""The edit `ego`: the recording vehicle shifted to the left or on a new trajectory, its sensors and
its body with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import FloatArray, Trajectory, invert_pose
from ...world.drive import Drive
from ..checks import require
from ..context import EditContext, sensor_span_s, with_riders
from ..edit import Edit, register
from ..motion.keys import Beyond, Keyframes, ShiftKey, check_keys
from ..motion.trajectories import (
    Indices,
    Resting,
    Stacked,
    displaced,
    merged_times,
    offset_curve,
    sampled_together,
)
from ..types import Scenario


@register
@dataclass(frozen=True)
class Ego(Edit):
    """The recording vehicle drives further left, or elsewhere; its sensors ride along."""

    type = "ego"
    seen_by = "ego"

    shift_left_m: float | None = None
    shift: tuple[ShiftKey, ...] | None = None
    trajectory: Keyframes | None = None
    outside: Beyond | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        given = [name for name in ("shift_left_m", "shift", "trajectory") if getattr(self, name) is not None]
        require(len(given) == 1, place, "needs shift_left_m, shift or trajectory, one of them")
        require(self.outside is None or self.trajectory is not None, f"{place}.outside", "needs a trajectory")
        check_keys(self.trajectory or (), f"{place}.trajectory")
        check_keys(self.shift or (), f"{place}.shift")

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with the vehicle, all its sensors and its body elsewhere.

        A shift keeps every heading and every sensor's place on the vehicle exactly, at any time. On a new trajectory
        the sensors keep their places to within `motion`'s tolerances; where it stands, they stand, to the bit.
        """
        if self.trajectory is not None:
            return _on_trajectory(drive, context.trajectory(None, self.trajectory, self.outside, place))
        if self.shift is None:
            times, left = np.array([min(drive.time_s.values())]), np.array([float(self.shift_left_m or 0.0)])
        else:
            times = context.key_times(self.shift, f"{place}.shift")
            left = np.array([key.left_m for key in self.shift], float)

        def offset_at(t: FloatArray) -> FloatArray:
            shift = np.interp(t, times, left)
            return np.stack([np.zeros_like(shift), shift, np.zeros_like(shift)], -1)

        start, end = sensor_span_s(drive)
        keys = merged_times(drive.world_from_ego.times_s, times, np.array([start, end]))
        curve = offset_curve(drive.world_from_ego, keys, offset_at)
        return with_riders(
            drive, displaced(drive.world_from_ego, curve), lambda riders: [displaced(rider, curve) for rider in riders]
        )


def _on_trajectory(drive: Drive, new: Trajectory) -> Drive:
    old = drive.world_from_ego
    start, end = sensor_span_s(drive)
    resting = Resting.on(new)

    def carried(riders: list[Trajectory]) -> list[Trajectory]:
        stacked, ends = Stacked(riders), np.array([start, end])

        def poses(t: FloatArray, which: Indices) -> FloatArray:
            t = resting.since(t)
            known = np.clip(t, start, end)  # beyond, sensors stay where they are on the vehicle
            return np.asarray(new.at(t) @ invert_pose(old.at(known)) @ stacked.at(known, which))

        times = [merged_times(new.times_s, old.times_s, rider.times_s, ends) for rider in riders]
        return sampled_together(poses, times)

    return with_riders(drive, new, carried)
