"""Clusters of a sweep's returns that nothing which stays explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, first_in_voxels
from .free_space import RangeImage, left_or_entered
from .ground import GroundHeights
from .scans import Scan

LOW_M, HIGH_M = 0.25, 4.5
"""Heights above the ground of returns that may be an actor's."""
THIN_M = 0.1
CELL_M = 0.3
"""Returns are of one cluster where their cells, seen from above, touch."""
LEAST_RETURNS = 4
MOVING = 0.3
"""Part of a cluster's returns that lie where other sweeps see through."""
WEAK_RETURNS = 8
"""Clusters of this many returns of which fewer do go on with tracks, and begin none."""
LARGEST_M = 20.0
AT_ONCE_S = 0.02
"""Clusters of one thing that are less apart in time are of one moment."""


@dataclass(frozen=True)
class Cluster:
    """Returns (N, 3) of one thing in a sweep, in the world, at their times (N,); ``origin`` (3,) of their rays; ``is_weak``:
    other sweeps do not see through its place, or do not observe it."""

    points: FloatArray
    time_s: FloatArray
    origin: FloatArray
    is_weak: bool = False

    @cached_property
    def middle_s(self) -> float:
        """Mean time of the returns."""
        return float(self.time_s.mean())

    @cached_property
    def middle(self) -> FloatArray:
        """Middle (2,) of the rectangle around the returns, along the world's axes."""
        return np.asarray((self.points[:, :2].min(0) + self.points[:, :2].max(0)) / 2)

    @cached_property
    def size_m(self) -> float:
        """Diagonal of that rectangle, metres."""
        return float(np.linalg.norm(np.ptp(self.points[:, :2], 0)))


def together(clusters: Sequence[Cluster]) -> list[Cluster]:
    """Return clusters of one thing in order of time, with those joined that several LiDARs see at once."""
    groups: list[list[Cluster]] = []
    for cluster in clusters:
        if groups and cluster.middle_s - groups[-1][0].middle_s < AT_ONCE_S:
            groups[-1].append(cluster)
        else:
            groups.append([cluster])
    return [group[0] if len(group) == 1 else merged(group) for group in groups]


def merged(clusters: Sequence[Cluster]) -> Cluster:
    """Return several clusters of one time as one."""
    points, time_s = (np.concatenate([getattr(cluster, name) for cluster in clusters]) for name in ("points", "time_s"))
    return Cluster(points, time_s, np.mean([cluster.origin for cluster in clusters], 0))


def above_ground(scan: Scan, ground: GroundHeights) -> NDArray[np.int64]:
    """Return indices of a sweep's returns between `LOW_M` and `HIGH_M` above the ground, one of each voxel."""
    height = scan.points[:, 2] - ground.height(scan.points)
    keep = np.flatnonzero((height > LOW_M) & (height < HIGH_M))
    return keep[first_in_voxels(scan.points[keep], THIN_M)]


def moving_clusters(
    scan: Scan, ground: GroundHeights, images: Mapping[int, RangeImage], chosen: Sequence[Sequence[int]]
) -> tuple[list[Cluster], FloatArray]:
    """Return clusters of a sweep that do not stand by what other sweeps (``chosen``: `free_space.windows`) see, and returns
    (N, 3) above the ground that do."""
    keep = above_ground(scan, ground)
    points, time_s, origins = scan.points[keep], scan.time_s[keep], scan.origins[keep]
    moving, stays = left_or_entered(points, images, chosen)
    other = np.flatnonzero(~stays)
    clusters = []
    xy = points[other, :2]
    for members in connected(np.floor((xy - xy.min(0, initial=np.inf)) / CELL_M).astype(np.int64)):
        at = other[members]
        size = np.ptp(points[at, :2], 0)
        is_weak = bool(moving[at].mean() < MOVING)
        if len(at) >= (WEAK_RETURNS if is_weak else LEAST_RETURNS) and size.max() < LARGEST_M:
            clusters.append(Cluster(points[at], time_s[at], origins[at].mean(0), is_weak))
    return clusters, points[~moving]


def connected(cell: NDArray[np.int64], corners: bool = True) -> list[NDArray[np.int64]]:
    """Return the rows of cells (N, 2) of each group that touch, by their edges or also by their ``corners``."""
    if not len(cell):
        return []
    from scipy import ndimage

    at = tuple((cell - cell.min(0)).T)
    grid = np.zeros(np.ptp(cell, 0) + 1, np.bool_)
    grid[at] = True
    label = ndimage.label(grid, np.ones((3, 3)) if corners else None)[0][at]
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
