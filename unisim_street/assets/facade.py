"""A house front with openings set back into the wall, as one shape with a closed-form intersection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray

from ..tracing.shapes import Solid, first_inside, slab

_SLACK = 2e-6
"""Metres by which an opening's cheeks, found with rounding, may lie beside it: those of triangles are
single precision's."""


@dataclass(frozen=True)
class Storey:
    """One storey's row of equal openings: count at ``pitch``, from ``first`` (left edge), each ``width`` wide, ``low``
    to ``high`` in height, ``depth`` deep; all in metres in the front's frame."""

    floor: float
    low: float
    high: float
    first: float
    pitch: float
    width: float
    count: int
    depth: float


class Facade(Solid):
    """A house ``width`` x ``depth`` x ``height`` whose front is the plane y = 0, looking along -y, x
    from 0 to ``width``.

    Openings are blind: a ray that enters one ends on its back or on one of its four cheeks. Storeys are given from the
    bottom up and no opening crosses its storey's floor or the house's edges.
    """

    def __init__(self, width: float, depth: float, height: float, storeys: tuple[Storey, ...]) -> None:
        self.width, self.depth, self.height = width, depth, height
        self.low, self.high = np.zeros(3), np.array([width, depth, height])
        self.storeys = storeys
        self._floors = np.array([s.floor for s in storeys])
        columns = ("low", "high", "first", "pitch", "width", "count", "depth")
        self._table = np.array([[float(getattr(s, name)) for name in columns] for s in storeys])

    def cell(self, points: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Storey and column (N,), (N,) of points' openings; column -1 where there is none at that x and z."""
        x, _, z = points.T
        storey = np.clip(np.searchsorted(self._floors, z, side="right") - 1, 0, len(self._floors) - 1)
        low, high, first, pitch, width, count, _ = self._table[storey].T
        column = np.floor((x - first + _SLACK) / pitch)
        across = x - first - column * pitch
        inside = (
            (column >= 0) & (column < count) & (across <= width + _SLACK) & (z >= low - _SLACK) & (z <= high + _SLACK)
        )
        return storey, np.where(inside, column, -1).astype(np.int64)

    def rectangle(self, storey: NDArray[np.int64], column: NDArray[np.int64]) -> tuple[FloatArray, ...]:
        """x_low, x_high, z_low, z_high, depth (N,) of openings."""
        low, high, first, pitch, width, _, depth = self._table[storey].T
        left = first + column * pitch
        return left, left + width, low, high, depth

    def intersect(self, origins: FloatArray, directions: FloatArray, t_min: FloatArray) -> FloatArray:
        x, y, z = (slab(origins[:, i], directions[:, i], self.low[i], self.high[i]) for i in range(3))
        far = np.minimum(np.minimum(x[1], y[1]), z[1])
        t = first_inside(np.maximum(np.maximum(x[0], y[0]), z[0]), far, t_min)
        rows = np.flatnonzero(np.isfinite(t))
        start = origins[rows] + t[rows, None] * directions[rows]
        storey, column = self.cell(start)
        left, right, low, high, depth = self.rectangle(storey, column)
        # only what starts within an opening's hollow goes on: on the front plane, or deeper after a part was cut away
        hollow = (column >= 0) & (start[:, 1] < depth - _SLACK)
        rows = rows[hollow]
        o, d = origins[rows], directions[rows]
        walls = np.stack(
            [np.where(d[:, 0] > 0, right[hollow], left[hollow]), np.where(d[:, 2] > 0, high[hollow], low[hollow])]
        )
        sides = np.stack([o[:, 0], o[:, 2]]), np.stack([d[:, 0], d[:, 2]])
        across = np.where(np.abs(sides[1]) > 1e-12, (walls - sides[0]) / _safe(sides[1]), np.inf).min(0)
        back = np.where(d[:, 1] > 0, (depth[hollow] - o[:, 1]) / _safe(d[:, 1]), np.inf)
        t_exit = np.minimum(across, back)
        leaves = (d[:, 1] < 0) & (-o[:, 1] / _safe(d[:, 1]) <= t_exit)
        t[rows] = np.where(leaves, np.inf, np.maximum(t_exit, t[rows]))
        return t

    def normals(self, points: FloatArray) -> FloatArray:
        storey, column = self.cell(points)
        left, right, low, high, depth = self.rectangle(storey, column)
        x, y, z = points.T
        hollow = (column >= 0) & (y <= depth + _SLACK) & (y > _SLACK)
        outer = np.stack([y, self.depth - y, x, self.width - x, z, self.height - z], -1)
        inner = np.stack(
            [np.abs(depth - y), np.abs(x - left), np.abs(right - x), np.abs(z - low), np.abs(high - z)], -1
        )
        ways_out = np.array([[0, -1, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, 1]], np.float64)
        ways_in = np.array([[0, -1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]], np.float64)
        chosen = np.where(hollow[:, None], ways_in[inner.argmin(1)], ways_out[np.abs(outer).argmin(1)])
        return np.asarray(chosen)


def _safe(x: FloatArray) -> FloatArray:
    return np.where(np.abs(x) < 1e-12, np.copysign(1e-12, x), x)
