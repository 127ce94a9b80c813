"""Standing vehicles: returns of all sweeps that stay, as a map of voxels, of which parts as large as a vehicle are fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from .boxes import closest_heading, completed, extent, viewed_from
from .clusters import connected
from .ground import GroundHeights
from .register import rotated
from .shape import USUAL_M

VOXEL_M = 0.15
RANGE_M = 60.0
BATCH = 16
"""Number of sweeps whose voxels are added to the map at once."""
TALL_M = (2.4, 2.9)
"""What returns at these heights, and below them, is no car: a wall, a trunk, a pole."""
LOW_M, HIGH_M = 0.25, 2.4
LEAST_SWEEPS, LEAST_VOXELS = 2, 12
MOST_PIECES_M, WEAK, PIECE_LOW_M = 14.0, 0.25, 0.4
"""What is no longer than this, and too long for a vehicle, is parted at its weakest voxels, and above this height."""
LONGEST_M, WIDEST_M, SHORTEST_M = 6.6, 2.8, 1.3
LOWEST_TOP_M, HIGHEST_TOP_M = 1.0, 2.35
CONE_M, CONE_TOP_M, CONE_CERTAINTY = 0.7, (0.4, 1.2), 0.25
"""What is smaller, and this high, is a candidate for a cone."""
SIDE_M, GLASS_M = (0.4, 0.95), (1.15, 1.7)
"""Heights of a car's side and of its windows, which lean in."""
LEANS_M = (0.08, 0.5)
EDGE_M = 0.2
END_M = 2.5
"""What is shorter is a vehicle's end alone."""
RING_M = 0.6
"""Width of the ring around a box in which something else may stand."""
COLUMNS = ("count", "x", "y", "z", "origin x", "origin y", "first", "last")
"""Values of a voxel: sums over its returns, and the times of the first and the last one, seconds."""


@dataclass(frozen=True)
class StandingBox:
    """A box (class, yaw, middle (2,), edges (3,)) around returns that stay, seen from ``first_s`` to ``last_s``."""

    label: str
    yaw_rad: float
    middle: FloatArray
    size_m: FloatArray
    first_s: float
    last_s: float
    returns: int
    sweeps: int
    features: tuple[float, ...] = ()
    """Of `certainty.FEATURES`, without what is around; none of a cone."""
    rise_m: float = 0.0
    """How much higher returns reach in the rear third than in the front one, metres; 0 where an end is not seen."""
    is_end: bool = False
    """Whether only an end is seen, so that the heading may be off by a quarter of a turn."""


class StandingMap:
    """Takes the returns of sweeps that stay, one sweep at a time; stores sums of each voxel."""

    def __init__(self, keys: NDArray[np.int32] | None = None, values: FloatArray | None = None) -> None:
        self.keys = np.zeros((0, 3), np.int32) if keys is None else keys
        self.values = np.zeros((0, len(COLUMNS))) if values is None else values
        self.batch: list[tuple[NDArray[np.int32], FloatArray]] = []

    def add(self, points: FloatArray, origin: FloatArray, time_s: float) -> None:
        """Add returns (N, 3) of a sweep from ``origin`` (3,)."""
        near = points[np.linalg.norm(points[:, :2] - origin[:2], axis=1) < RANGE_M]
        keys, inverse, count = np.unique(
            np.floor(near / VOXEL_M).astype(np.int32), axis=0, return_inverse=True, return_counts=True
        )
        if not len(keys):
            return
        means = np.stack([np.bincount(inverse.ravel(), near[:, axis]) for axis in range(3)], 1) / count[:, None]
        one = np.ones(len(keys))
        values = [one, *means.T, one * origin[0], one * origin[1], one * time_s, one * time_s]
        self.batch.append((keys, np.stack(values, 1)))
        if len(self.batch) >= BATCH:
            self._merge()

    def _merge(self) -> None:
        keys = np.concatenate([self.keys, *(keys for keys, _ in self.batch)])
        values = np.concatenate([self.values, *(values for _, values in self.batch)])
        self.batch = []
        order = np.lexsort(keys.T)
        keys, values = keys[order], values[order]
        first = np.flatnonzero(np.append(True, (np.diff(keys, axis=0) != 0).any(1))) if len(keys) else np.zeros(0, int)
        self.keys = keys[first]
        if len(first):
            sums = np.add.reduceat(values[:, :6], first)
            begin, end = np.minimum.reduceat(values[:, 6], first), np.maximum.reduceat(values[:, 7], first)
            self.values = np.concatenate([sums, begin[:, None], end[:, None]], 1)

    def content(self) -> tuple[NDArray[np.int32], FloatArray]:
        """Return the voxels (N, 3) and their values (N, `COLUMNS`)."""
        self._merge()
        return self.keys, self.values

    def voxels(self, ground: GroundHeights) -> FloatArray:
        """Return voxels (N, `COLUMNS`) that `LEAST_SWEEPS` saw, with means in place of sums, and heights above the ground
        in place of z."""
        values = self.content()[1]
        values = values[values[:, 0] >= LEAST_SWEEPS]
        values = np.concatenate([values[:, :1], values[:, 1:6] / values[:, :1], values[:, 6:]], 1)
        values[:, 3] -= ground.height(values[:, 1:3])
        return values

    def parts(self, ground: GroundHeights) -> list[FloatArray]:
        """Return `voxels` of each thing below `HIGH_M`; what is taller is left out."""
        from scipy import ndimage

        values = self.voxels(ground)
        if not len(values):
            return []
        cell = np.floor(values[:, 1:3] / VOXEL_M).astype(np.int64)
        cell -= cell.min(0)
        shape = tuple((cell.max(0) + 1).tolist())
        tall, low = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
        is_tall = (values[:, 3] > TALL_M[0]) & (values[:, 3] < TALL_M[1])
        is_low = (values[:, 3] > LOW_M) & (values[:, 3] < HIGH_M)
        tall[tuple(cell[is_tall].T)] = True
        low[tuple(cell[is_low].T)] = True
        below_tall = ndimage.binary_dilation(tall & ndimage.binary_dilation(low))[tuple(cell.T)]
        rows = np.flatnonzero(is_low & ~below_tall)
        parts = [values[rows[part]] for part in connected(cell[rows]) if len(part) >= LEAST_VOXELS]
        return [piece for part in parts for piece in _pieces(part)]


def _pieces(voxels: FloatArray) -> list[FloatArray]:
    """Return parts of voxels that are larger than a vehicle, where fewer returns connect them; else the voxels."""
    longer = float(np.ptp(rotated(-closest_heading(voxels[:, 1:3]), voxels[:, 1:3]), 0).max())
    if not LONGEST_M < longer < MOST_PIECES_M:
        return [voxels]
    strong = voxels[(voxels[:, 0] >= np.quantile(voxels[:, 0], WEAK)) & (voxels[:, 3] > PIECE_LOW_M)]
    cell = np.floor((strong[:, 1:3] - strong[:, 1:3].min(0)) / VOXEL_M).astype(np.int64)
    return [strong[piece] for piece in connected(cell, corners=False) if len(piece) >= LEAST_VOXELS]


def standing_box(voxels: FloatArray) -> StandingBox | None:
    """Return the box of a vehicle around voxels of `StandingMap.parts`; None where they are no vehicle's."""
    xy, top = voxels[:, 1:3], float(np.quantile(voxels[:, 3], 0.98))
    yaw = closest_heading(xy)
    spans = np.ptp(extent(rotated(-yaw, xy)), 0)
    if spans.max() < CONE_M and CONE_TOP_M[0] < top < CONE_TOP_M[1]:
        return _cone(voxels, top)
    if not LOWEST_TOP_M < top < HIGHEST_TOP_M:
        return None
    shorter, longer = sorted(spans.tolist())
    if longer > LONGEST_M or shorter > WIDEST_M or longer < SHORTEST_M:
        return None
    is_end = longer < END_M  # an end alone is wider than it is deep
    if (spans[1] > spans[0]) != is_end:
        yaw += np.pi / 2
    local, views, usual = rotated(-yaw, xy), rotated(-yaw, voxels[:, 4:6]), np.array(USUAL_M["Car"][:2])
    ends = extent(local)
    middle, edges = completed(ends, usual, viewed_from(ends, usual, views))
    size = np.append(edges, top)
    features = _features(voxels, local - middle, views[:, 1] - middle[1], size)
    rise = _rise(local[:, 0], voxels[:, 3])
    return StandingBox("Car", float(yaw), rotated(yaw, middle), size, *_seen(voxels), features, rise, is_end)


def _seen(voxels: FloatArray) -> tuple[float, float, int, int]:
    """Return when voxels were seen first and last, and by how many returns of how many sweeps."""
    counts = voxels[:, 0]
    return float(voxels[:, 6].min()), float(voxels[:, 7].max()), int(counts.sum()), int(counts.max())


def _cone(voxels: FloatArray, top: float) -> StandingBox:
    """Return the box of something as small as a cone, which may be much else."""
    low, high = voxels[:, 1:3].min(0), voxels[:, 1:3].max(0)
    return StandingBox(
        "Cones", 0.0, (low + high) / 2, np.array([*np.maximum(high - low, VOXEL_M), top]), *_seen(voxels)
    )


def _rise(along: FloatArray, height: FloatArray) -> float:
    low, high = extent(along)
    third = (high - low) / 3
    rear, front = height[along < low + third], height[along > high - third]
    if high - low < END_M or min(len(rear), len(front)) < LEAST_VOXELS:
        return 0.0
    return float(np.quantile(rear, 0.9) - np.quantile(front, 0.9))


def _features(voxels: FloatArray, local: FloatArray, across: FloatArray, size: FloatArray) -> tuple[float, ...]:
    """Return `certainty.FEATURES` of voxels, at ``local`` (N, 2) in the frame of a box of edges ``size`` (3,), seen from
    ``across`` (N,)."""
    height = voxels[:, 3]
    spans = np.ptp(local, 0)
    side, glass = ((height > low) & (height < high) for low, high in (SIDE_M, GLASS_M))
    lean = float("nan")
    if min(side.sum(), glass.sum()) > 5:
        towards = np.sign(across.mean()) * local[:, 1]
        lean = float(np.quantile(towards[side], 0.95) - np.quantile(towards[glass], 0.95))
    depth = np.minimum(local - local.min(0), local.max(0) - local).min(1)
    edges = np.abs(size[:2] / 2 - np.abs(local)).min(1)
    return (
        float((depth > EDGE_M).mean()),
        float(LEANS_M[0] < lean < LEANS_M[1]),
        float(np.prod(np.minimum(spans / USUAL_M["Car"][:2], 1.0))),
        float(abs(size[2] - USUAL_M["Car"][2])),
        float(np.median(edges[side])) if side.any() else EDGE_M,
    )


def around(box: StandingBox, stays: FloatArray) -> float:
    """Return the logarithm of how much stands in a ring around a box, beside what stands inside: little around what is
    parked, much around a piece of a hedge. ``stays``: `StandingMap.voxels`."""
    near = stays[(np.abs(stays[:, 1:3] - box.middle) < box.size_m.max()).all(1)]
    near = near[(near[:, 3] > LOW_M) & (near[:, 3] < HIGH_M)]
    local = rotated(-box.yaw_rad, near[:, 1:3] - box.middle)
    beyond = (np.abs(local) - box.size_m[:2] / 2).max(1)
    inside = beyond < VOXEL_M
    return float(np.log((1 + (~inside & (beyond < RING_M)).sum()) / (1 + inside.sum())))
