"""Trajectories of many actors as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, slerp
from .drive import Actor

AT_ONCE = 1 << 24
"""So many comparisons of keys with times are made at once; of a long drive's, rows are searched one by one."""


@dataclass(frozen=True)
class PaddedKeys:
    """Trajectory keys of A actors, padded to K: times_s (A, K), inf where there is none; positions (A, K, 3), world
    frame; quaternions_wxyz (A, K, 4); lengths (A,), how many keys each has."""

    times_s: FloatArray
    positions: FloatArray
    quaternions_wxyz: FloatArray
    lengths: NDArray[np.int32]

    @staticmethod
    def of(actors: Sequence[Actor]) -> PaddedKeys:
        """Return the keys of actors, one row each."""
        trajectories = [actor.world_from_actor for actor in actors]
        lengths = np.array([len(one.times_s) for one in trajectories], np.int32)
        shape = len(trajectories), int(lengths.max(initial=1))
        times, positions = np.full(shape, np.inf), np.zeros((*shape, 3))
        quaternions = np.tile([1.0, 0, 0, 0], (*shape, 1))
        real = np.arange(shape[1]) < lengths[:, None]
        if trajectories:
            times[real] = np.concatenate([one.times_s for one in trajectories])
            positions[real] = np.concatenate([one.positions for one in trajectories])
            quaternions[real] = np.concatenate([one.quaternions_wxyz for one in trajectories])
        return PaddedKeys(times, positions, quaternions, lengths)

    def positions_at(self, times_s: FloatArray) -> FloatArray:
        """Return where the actors are (A, T, 3) at times (T,): `Trajectory.positions_at` of each."""
        row, lower, upper, u = self._between(times_s)
        start = self.positions[row, lower]
        return np.asarray(start + u[..., None] * (self.positions[row, upper] - start))

    def quaternions_at(self, times_s: FloatArray) -> FloatArray:
        """Return how the actors are turned, quaternions wxyz (A, T, 4), at times (T,)."""
        row, lower, upper, u = self._between(times_s)
        return slerp(self.quaternions_wxyz[row, lower], self.quaternions_wxyz[row, upper], u)

    def _between(
        self, times_s: FloatArray
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], FloatArray]:
        """Return rows (A, 1), the keys (A, T) before times (T,) and after, and how far each time is between them."""
        single = self.lengths[:, None] == 1
        if self.times_s.size * len(times_s) <= AT_ONCE:
            before = (self.times_s[:, None] <= times_s[None, :, None]).sum(-1) - 1
        else:
            before = np.array([np.searchsorted(row, times_s, "right") for row in self.times_s]) - 1
        lower = np.clip(before, 0, np.maximum(self.lengths - 2, 0)[:, None])
        upper = np.where(single, 0, lower + 1)
        row = np.arange(len(self.lengths))[:, None]
        first, span = (
            self.times_s[row, lower],
            np.where(single, 1.0, self.times_s[row, upper] - self.times_s[row, lower]),
        )
        return row, lower, upper, np.where(single, 0.0, (times_s - first) / span)
