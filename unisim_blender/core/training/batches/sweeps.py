"""LiDAR rays as a step takes them; and the sweeps of a long drive, a window of them that moves on as the steps go by."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...data.log import Log
from ...data.sweep_cells import known_rays
from ...geometry import FloatArray, invert_pose, transform_points
from ...ops.ray_segments import RayBatch
from ...world.drive import Actor, Drive
from ..seeding import VoxelEvidence
from .images import MOST_OFTEN
from .window import Window


@dataclass(frozen=True)
class LidarBatch:
    """LiDAR rays with what they measured: depth_m, intensity (N,), returned (N,) bool; weight (N,) makes drops, of
    which more are drawn than there are, count as often as they occur."""

    rays: RayBatch
    depth_m: Tensor
    intensity: Tensor
    returned: Tensor
    weight: Tensor


def ray_batch(
    origins: NDArray[np.floating[Any]], directions: NDArray[np.floating[Any]], time_s: FloatArray
) -> RayBatch:
    """Rays as tensors, origins (N, 3) from the volume's corner."""
    return RayBatch(
        torch.as_tensor(np.ascontiguousarray(origins, np.float32)),
        torch.as_tensor(np.ascontiguousarray(directions, np.float32)),
        torch.as_tensor(np.ascontiguousarray(time_s, np.float64)),
    )


def lidar_batch(
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    time_s: FloatArray,
    depth_m: NDArray[np.float32],
    intensity: NDArray[np.float32],
    returned: NDArray[np.bool_],
    share: float,
    drops: float,
) -> LidarBatch:
    """Rays (N,) of which ``drops`` are drops, drawn of rays of which ``share`` are."""
    weights = (1 - share) / (1 - drops), share / drops if drops else 0.0
    return LidarBatch(
        ray_batch(origins, directions, time_s),
        torch.as_tensor(depth_m).float(),
        torch.as_tensor(intensity).float(),
        torch.as_tensor(returned),
        torch.as_tensor(np.where(returned, *weights)).float(),
    )


def boxes_of(points: FloatArray, times: FloatArray, actors: Iterable[Actor]) -> NDArray[np.int32]:
    """Return the number (N,) of an actor in whose box, a little enlarged, points (N, 3), world frame, of these times (N,) lie;
    -1 for those in none."""
    # sorted by one coordinate, what a box can hold is a slice
    order = np.argsort(points[:, 0])
    ordered, times = points[order], times[order]
    owner = np.full(len(points), -1, np.int32)
    first_s, last_s = times.min(initial=np.inf), times.max(initial=-np.inf)
    for number, actor in enumerate(actors):
        if actor.start_s > last_s or actor.end_s < first_s:
            continue
        trajectory, enlarged = actor.world_from_actor, np.asarray(actor.size_m) + 0.2
        radius = np.linalg.norm(enlarged) / 2
        low, high = trajectory.positions.min(0) - radius, trajectory.positions.max(0) + radius
        begin, end = np.searchsorted(ordered[:, 0], (low[0], high[0]))
        part = ordered[begin:end]
        near = (part[:, 1] >= low[1]) & (part[:, 1] <= high[1]) & actor.present(times[begin:end])
        at = begin + np.flatnonzero(near)
        # labels of what stands still may waver: it has one pose
        when = times[at] if actor.is_moving else np.full(len(at), (actor.start_s + actor.end_s) / 2)
        close = ((ordered[at] - trajectory.positions_at(when)) ** 2).sum(1) <= radius**2
        at, when = at[close], when[close]
        local = transform_points(invert_pose(trajectory.at(when)), ordered[at][:, None])[:, 0]
        owner[order[at[(np.abs(local) <= enlarged / 2).all(1)]]] = number
    return owner


def some_of_each(owner: NDArray[np.int32], most: int) -> NDArray[np.int64]:
    """Return numbers of the points of each owner (N,), evenly spread ``most`` of them at most; -1 is none."""
    owned = np.flatnonzero(owner >= 0)
    owned = owned[np.argsort(owner[owned], kind="stable")]
    _, first, of_owner, counts = np.unique(owner[owned], return_index=True, return_inverse=True, return_counts=True)
    place, count = np.arange(len(owned)) - first[of_owner], counts[of_owner]
    return np.sort(owned[place * most // count != (place - 1) * most // count])


def drawn_of_actors(of_actors: int, hits: int) -> float:
    """Return the share of the returns drawn that is drawn from those of actors, of which a sweep has so many among its hits."""
    return min(ACTOR_SHARE, MOST_OFTEN * of_actors / max(hits, 1))


SweepRef = tuple[str, int]
"""A LiDAR's name, a frame."""
Mark = Callable[[FloatArray, FloatArray], VoxelEvidence]
"""Which voxels rays tell of: origins and static returns (N, 3), world frame."""

RAY_BYTES = 41
"""Bytes of a ray in memory: origin and direction, depth and intensity as float32, its time as float64, whether it returned."""
MEMORY_SWEEPS, MEMORY_BYTES = 160, 1 << 30
"""Largest number of sweeps, and of bytes of their rays, that are all loaded at the start."""
WINDOW_BYTES = 1 << 29
"""Largest size of a window of sweeps, bytes."""
UNTABLED_RAYS = 1 << 18
"""Number of rays, spread over the sweep, that are loaded of a sweep without a beam table."""
FIRST_EVERY_M, FIRST_SWEEPS = 60.0, (12, 64)
"""Before the first step there is a sweep for every so many metres of the drive, of each LiDAR, so many at least and at most:
returns from tens of metres around tell of the ground and of where to look for surfaces."""
AHEAD = 4
"""Sweeps that are read before their step comes."""
ACTOR_SHARE, ACTOR_RETURNS = 0.2, 256
"""Share of the returns drawn that is drawn from actors' alone, at most, and how many of an actor's in a sweep are then drawn from
at most: a walker has a thousandth of a sweep's returns, and even draws would teach little of the walker."""
STEPS_PER_SWEEP = 4
"""Steps from one sweep that a window takes in to the next."""


def rays_at_most(drive: Drive, lidars: Iterable[str]) -> int:
    """How many rays a sweep of some LiDARs is held with."""
    models = (drive.lidars[lidar].model for lidar in lidars)
    return max((model.beams * model.columns or UNTABLED_RAYS for model in models), default=0)


def all_sweeps_fit(drive: Drive, captures: Sequence[SweepRef]) -> bool:
    """Whether so many sweeps are held from the start."""
    rays = rays_at_most(drive, {lidar for lidar, _ in captures})
    return len(captures) <= MEMORY_SWEEPS and len(captures) * rays * RAY_BYTES <= MEMORY_BYTES


def first_sweeps(drive: Drive, captures: Sequence[SweepRef]) -> list[int]:
    """Return numbers of the captures that are read before the first step: of each LiDAR evenly along the drive."""
    chosen: list[int] = []
    for name in dict.fromkeys(lidar for lidar, _ in captures):
        own = [number for number, (lidar, _) in enumerate(captures) if lidar == name]
        times = np.array([drive.lidars[name].time_s[captures[number][1]] for number in own])
        steps = np.linalg.norm(np.diff(drive.world_from_ego.positions_at(times), axis=0), axis=1)
        # a vehicle that stands goes on by a little, so that the way tells its places in time apart
        way = np.append(0.0, np.cumsum(steps + 0.01))
        least, most = FIRST_SWEEPS
        count = min(len(own), max(least, min(most, int(way[-1] / FIRST_EVERY_M) + 1)))
        places = np.searchsorted(way, np.linspace(0, way[-1], count))
        chosen += [own[place] for place in np.unique(np.minimum(places, len(own) - 1))]
    return chosen


class SweepWindow:
    """A `Window` of sweeps of ``limit`` bytes at most, drops included, the ego vehicle's own cells left out; origins are measured
    from ``corner`` (3,), world frame.

    ``mark`` says which voxels a sweep's returns outside of the boxes of ``actors`` tell of; `advance` hands that out as sweeps
    come in.
    """

    def __init__(
        self,
        log: Log,
        captures: Sequence[SweepRef],
        corner: FloatArray,
        seed: int,
        actors: Iterable[Actor],
        mark: Mark,
        limit: int = WINDOW_BYTES,
    ) -> None:
        self.corner = corner
        self._log, self._captures, self._mark = log, list(captures), mark
        self._actors = list(actors)
        first = first_sweeps(log.drive, captures)
        self._rays = rays_at_most(log.drive, {lidar for lidar, _ in captures})
        slots = min(len(captures) + AHEAD, max(len(first) + 2 * AHEAD, limit // (RAY_BYTES * self._rays)))
        self._origins, self._directions = (np.zeros((slots, self._rays, 3), np.float32) for _ in range(2))
        self._depth_m, self._intensity = (np.zeros((slots, self._rays), np.float32) for _ in range(2))
        self._time_s = np.zeros((slots, self._rays))
        self._counts = np.zeros((slots, 3), np.int64)
        """Rays of each slot: its hits, which come first, its drops, and those hits, the first, that are drawn of actors."""
        self._evidence: dict[int, VoxelEvidence] = {}
        self._first: dict[int, tuple[FloatArray, FloatArray] | None] = dict.fromkeys(first)
        """Static returns of the first sweeps, until they are asked for."""
        self._window = Window(len(captures), slots, AHEAD, STEPS_PER_SWEEP, first, (seed, 0x11DA), self._load, "sweeps")
        self._drawable = np.zeros(0, np.int64)

    @property
    def capacity(self) -> int:
        """How many sweeps may be drawn from at most."""
        return self._window.capacity

    @property
    def nbytes(self) -> int:
        """Bytes of the rays' memory."""
        arrays = (self._origins, self._directions, self._depth_m, self._intensity, self._time_s)
        return sum(array.nbytes for array in arrays)

    def advance(self, step: int) -> list[VoxelEvidence]:
        """Have the step's sweeps, and those of the next steps under way. Return what those tell that the step before had not; of
        the first, `first_evidence` tells."""
        self._drawable = self._window.advance(step)
        arrived = self._window.arrived(step) if step else []
        evidence = [self._evidence[sweep] for sweep in arrived]
        for sweep in self._drawable.tolist():
            self._evidence.pop(sweep, None)
        return evidence

    def static_returns(self) -> tuple[FloatArray, FloatArray]:
        """Origins and points (N, 3) of the first sweeps' returns that lie in none of the actors' boxes, world frame. They are
        given away: it is asked for once."""
        self._window.advance(0)
        parts = [part for sweep in sorted(self._first) if (part := self._first[sweep]) is not None]
        self._first = {}
        origins, points = (np.concatenate(part) for part in zip(*parts, strict=True))
        return origins, points

    def first_evidence(self) -> list[VoxelEvidence]:
        """Return the voxel evidence of the first sweeps; available until the first step."""
        return [self._evidence[sweep] for sweep in self._window.advance(0).tolist()]

    def points_by_sweep(self) -> Iterator[FloatArray]:
        """Every return of every sweep (N, 3), world frame; they are read anew."""
        for capture in self._captures:
            rays = known_rays(self._log, *capture)
            yield (rays.origins + rays.directions * rays.depth_m[:, None].astype(np.float64))[rays.returned]

    def sample(self, rng: np.random.Generator, count: int, drops: float = 0.15) -> LidarBatch:
        """``count`` random rays, a share of them drops."""
        slots = self._window.slot[self._drawable]
        hits, missed, own = self._counts[slots].T
        n_drops = int(count * drops) if missed.any() else 0
        n_own = int((count - n_drops) * drawn_of_actors(int(own.sum()), int(hits.sum())))
        slot, ray = _pick(rng, slots, hits, count - n_drops - n_own)
        if n_own:
            slot, ray = (np.append(a, b) for a, b in zip((slot, ray), _pick(rng, slots, own, n_own), strict=True))
        if n_drops:
            other, at = _pick(rng, slots, missed, n_drops)
            slot, ray = np.append(slot, other), np.append(ray, self._counts[other, 0] + at)
        return lidar_batch(
            self._origins[slot, ray], self._directions[slot, ray], self._time_s[slot, ray], self._depth_m[slot, ray],
            self._intensity[slot, ray], ray < self._counts[slot, 0], missed.sum() / (hits.sum() + missed.sum()), n_drops / count,
        )  # fmt: skip

    def _load(self, sweep: int, slot: int) -> None:
        rays = known_rays(self._log, *self._captures[sweep])
        order = np.argsort(~rays.returned, kind="stable")
        if len(order) > self._rays:
            order = order[np.linspace(0, len(order) - 1, self._rays).round().astype(np.int64)]
        hits, drops = np.split(order, [int(rays.returned[order].sum())])
        origins, times = rays.origins[hits], rays.time_s[hits]
        points = origins + rays.directions[hits] * rays.depth_m[hits, None]
        owner = boxes_of(points, times, self._actors)
        own = some_of_each(owner, ACTOR_RETURNS)
        order = np.concatenate([hits[own], np.delete(hits, own), drops])
        n = len(order)
        self._origins[slot, :n] = rays.origins[order] - self.corner
        self._directions[slot, :n] = rays.directions[order]
        self._time_s[slot, :n], self._depth_m[slot, :n] = rays.time_s[order], rays.depth_m[order]
        self._intensity[slot, :n] = rays.intensity[order]
        self._counts[slot] = len(hits), len(drops), len(own)
        origins, points = origins[owner < 0], points[owner < 0]
        if sweep in self._first:
            self._first[sweep] = origins, points
        self._evidence[sweep] = self._mark(origins, points)


def _pick(
    rng: np.random.Generator, slots: NDArray[np.int64], counts: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Slots (count,) and rays of them, of so many that each slot has, all with the same chance."""
    ends = np.cumsum(counts)
    drawn = rng.integers(ends[-1], size=count)
    which = np.searchsorted(ends, drawn, side="right")
    return slots[which], drawn - (ends - counts)[which]
