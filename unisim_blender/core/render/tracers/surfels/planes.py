"""Local planes of a point cloud: each place's normal, and how densely points lie about it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .... import native
from ....errors import SceneError

PointArray = NDArray[np.float32]


class FittedPlanes(NamedTuple):
    """Of places (N, 3): number (N,) of the points that were looked at; normal (N, 3), unit, 0 where they are fewer than
    three; height_m (N,) of their mean over the place along the normal, and rough_m (N,), their deviation along it;
    reach_m (N,) from the place to the farthest of them."""

    number: NDArray[np.int32]
    normal: NDArray[np.float32]
    height_m: NDArray[np.float32]
    rough_m: NDArray[np.float32]
    reach_m: NDArray[np.float32]


class Neighbours:
    """Points (N, 3) sorted into cubes of ``radius_m``, ready to be asked for those near a place. Raises `SceneError`
    where the compiled kernels are absent: the plain reference, of the tests, is for small clouds alone."""

    def __init__(self, points: PointArray, radius_m: float) -> None:
        self.lib = native.library()
        if self.lib is None:
            raise SceneError("surfels are made by the compiled kernels, which are not there: run make setup")
        self.radius_m = radius_m
        low = points.min(0).astype(np.float64) - 2 * radius_m if len(points) else np.zeros(3)
        cell = np.floor((points - low) / radius_m).astype(np.int64)
        dims = cell.max(0) + 3 if len(points) else np.ones(3, np.int64)
        key = (cell[:, 0] * dims[1] + cell[:, 1]) * dims[2] + cell[:, 2]
        order = np.argsort(key, kind="stable")
        key = key[order]
        first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]]) if len(key) else np.zeros(0, np.int64)
        self.points = np.ascontiguousarray(points[order], np.float32)
        self.keys = np.ascontiguousarray(key[first])
        self.starts = np.r_[first, len(key)].astype(np.int64)
        self.low, self.dims = np.ascontiguousarray(low), np.ascontiguousarray(dims)

    def planes(self, places: PointArray, most: int) -> FittedPlanes:
        """The planes through the ``most`` points nearest to each place (M, 3), within the radius."""
        assert self.lib is not None
        places, m = np.ascontiguousarray(places, np.float32), len(places)
        found = FittedPlanes(
            np.empty(m, np.int32), np.empty((m, 3), np.float32), *(np.empty(m, np.float32) for _ in range(3))
        )
        table = (x.ctypes.data for x in (self.points, self.keys, self.starts))
        grid = (self.low.ctypes.data, self.dims.ctypes.data, self.radius_m, most, places.ctypes.data, m)
        self.lib.unisim_local_planes(*table, len(self.keys), *grid, *(x.ctypes.data for x in found), native.threads())
        return found
