"""Where the recording has all actors at a time, computed at once."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping

import numpy as np

from ...geometry import Trajectory, slerp
from ..states import Quaternion, Vector

KEPT = 4
"""A step asks for the poses at its end again and again, and for those that close an exposure."""


class RecordedPoses:
    """Poses of trajectories by their names: each has the bits of its `Trajectory.placed_at`."""

    def __init__(self, trajectories: Mapping[str, Trajectory]) -> None:
        moving = {uid: one for uid, one in trajectories.items() if len(one.times_s) > 1}
        self._times = {uid: one.times_s.tolist() for uid, one in moving.items()}
        self._first = np.cumsum([0, *(len(times) for times in self._times.values())])[:-1]
        self._keys = [np.concatenate([one.times_s for one in moving.values()])] if moving else []
        self._keys += [np.concatenate([one.positions for one in moving.values()])] if moving else []
        self._keys += [np.concatenate([one.quaternions_wxyz for one in moving.values()])] if moving else []
        self._standing = {
            uid: _pose(one.positions[0].tolist(), one.quaternions_wxyz[0].tolist())
            for uid, one in trajectories.items()
            if uid not in moving
        }
        self._known: dict[float, dict[str, tuple[Vector, Quaternion]]] = {}

    def at(self, time_s: float) -> Mapping[str, tuple[Vector, Quaternion]]:
        """Return positions and quaternions at a time, by name."""
        if time_s not in self._known:
            while len(self._known) >= KEPT:
                del self._known[next(iter(self._known))]
            self._known[time_s] = self._standing | self._moving(time_s)
        return self._known[time_s]

    def _moving(self, time_s: float) -> dict[str, tuple[Vector, Quaternion]]:
        if not self._times:
            return {}
        times, positions, quaternions = self._keys
        lower = self._first + [min(max(bisect_right(own, time_s) - 1, 0), len(own) - 2) for own in self._times.values()]
        u = (time_s - times[lower]) / (times[lower + 1] - times[lower])
        placed = positions[lower] + u[:, None] * (positions[lower + 1] - positions[lower])
        turned = slerp(quaternions[lower], quaternions[lower + 1], u)
        poses = map(_pose, placed.tolist(), turned.tolist())
        return dict(zip(self._times, poses, strict=True))


def _pose(position: list[float], quaternion: list[float]) -> tuple[Vector, Quaternion]:
    (x, y, z), (w, i, j, k) = position, quaternion
    return (x, y, z), (w, i, j, k)
