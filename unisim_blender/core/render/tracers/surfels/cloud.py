"""A log's returns of all sweeps, divided into static ones and those of each actor, thinned as they are gathered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....data.log import Sweep
from ....geometry import FloatArray, invert_pose
from ....world.drive import Actor, Drive

POINT_CELL_M = 0.04
"""Edge, metres, of the cubes whose returns become one point, their mean, which averages range noise out."""
BOX_MARGINS_M = np.array([0.15, 0.15, 0.1])
"""Margins beside an actor's box, metres, within which returns are the actor's too: annotated boxes are tight."""
ACTOR_MOTION_SLACK_M = 4.0
"""Largest distance, in metres, that an actor moves between a return's time and the sweep's."""
MERGE_BATCH_POINTS = 1 << 21


@dataclass
class PointSums:
    """Points as sums: key (N,) of cubes, ascending; total (N, 8) of x, y, z, intensity, the sensor's x, y, z, and 1."""

    edge_m: float = POINT_CELL_M
    key: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    total: FloatArray = field(default_factory=lambda: np.zeros((0, 8)))
    _waiting: list[tuple[NDArray[np.int64], FloatArray]] = field(default_factory=list)
    _count: int = 0

    def add(self, points: FloatArray, intensity: NDArray[np.float32], origins: FloatArray) -> None:
        """Add returns (N, 3) with intensities (N,) of rays from origins (N, 3), metres."""
        rows = np.concatenate([points, intensity[:, None], origins, np.ones((len(points), 1))], 1)
        self._waiting.append((cube_keys(points, self.edge_m), rows))
        self._count += len(points)
        if self._count >= MERGE_BATCH_POINTS:
            self.merge()

    def merge(self) -> None:
        """Sum the points of each cube."""
        if self._waiting:
            key = np.concatenate([self.key, *(key for key, _ in self._waiting)])
            rows = np.concatenate([self.total, *(rows for _, rows in self._waiting)])
            self.key, self.total = summed(key, rows)
            self._waiting, self._count = [], 0

    @property
    def points(self) -> FloatArray:
        """Means (N, 3)."""
        return self.total[:, :3] / self.total[:, 7:]

    @property
    def intensity(self) -> FloatArray:
        """Mean intensities (N,)."""
        return self.total[:, 3] / self.total[:, 7]

    @property
    def sensors(self) -> FloatArray:
        """Mean places (N, 3) that they were seen from."""
        return self.total[:, 4:7] / self.total[:, 7:]


def cube_keys(points: FloatArray, edge_m: float) -> NDArray[np.int64]:
    """Return the numbers (N,) int64 of the cubes of edge ``edge_m`` of points (N, 3) within 40 km of the origin."""
    cell = np.floor(points / edge_m).astype(np.int64) + (1 << 20)
    return (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]


def summed(key: NDArray[np.int64], rows: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the different keys (M,), ascending, and the sums (M, C) of their rows (N, C)."""
    if len(key) == 0:
        return key, rows
    order = np.argsort(key, kind="stable")
    key, rows = key[order], rows[order]
    first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    return key[first], np.add.reduceat(rows, first, 0)


def part_of(sweep: Sweep, rows: NDArray[np.int64]) -> Sweep:
    """Return some of a sweep's returns, without the rays that did not return."""
    arrays = {f.name: getattr(sweep, f.name) for f in fields(sweep) if f.name != "drops"}
    parts: dict[str, Any] = {name: None if array is None else array[rows] for name, array in arrays.items()}
    return Sweep(**parts)


def gather_sweep(
    drive: Drive, actors: Sequence[Actor], sweep: Sweep, time_s: float
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the index (N,) of the actor that each return belongs to, -1 for none, and its place (N, 3) in the actor's
    box, or in the world. ``time_s`` is the sweep's."""
    owner, places = np.full(len(sweep.points), -1), sweep.points.copy()
    order = np.argsort(sweep.points[:, 0], kind="stable")
    rising = sweep.points[order, 0]
    for number, actor in enumerate(actors):
        start, end = drive.window(actor)
        if not start - ACTOR_MOTION_SLACK_M / 10 <= time_s <= end + ACTOR_MOTION_SLACK_M / 10:
            continue
        centre = actor.world_from_actor.at(time_s)[:3, 3]
        reach = np.linalg.norm(actor.size_m) / 2 + (ACTOR_MOTION_SLACK_M if actor.is_moving else 0.3)
        near = order[slice(*np.searchsorted(rising, [centre[0] - reach, centre[0] + reach]))]
        near = near[(np.abs(sweep.points[near] - centre) < reach).all(1) & (owner[near] < 0)]
        near = near[(sweep.time_s[near] >= start) & (sweep.time_s[near] <= end)]
        if len(near) == 0:
            continue
        inside = invert_pose(actor.world_from_actor.at(sweep.time_s[near]))
        local = np.einsum("nij,nj->ni", inside[:, :3, :3], sweep.points[near]) + inside[:, :3, 3]
        mine = (np.abs(local) <= actor.size_m / 2 + BOX_MARGINS_M).all(1)
        owner[near[mine]], places[near[mine]] = number, local[mine]
    return owner, places
