"""Shapes of multiresolution hash grids, and the form in which the kernels read them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import native


@dataclass(frozen=True)
class GridShape:
    """Shape of a hash grid: for each level in ``scale`` the number of cells along the axes, ``features`` a level, and
    at most ``2 ** log2_table`` rows in a level's table.

    A level whose vertices fit its table is dense (one row a vertex); the others are hashed.
    """

    scale: tuple[tuple[float, float, float], ...]
    features: int
    log2_table: int

    @staticmethod
    def cubic(extent_m: tuple[float, float, float], coarsest_m: float, finest_m: float, levels: int, features: int,
              log2_table: int) -> GridShape:  # fmt: skip
        """Return the shape with cells from ``coarsest_m`` to ``finest_m`` in geometric steps over a box of
        ``extent_m``."""
        cells = np.geomspace(coarsest_m, finest_m, levels)
        return GridShape(tuple(tuple(float(e / c) for e in extent_m) for c in cells), features, log2_table)  # type: ignore[misc]

    @staticmethod
    def unit(coarsest: int, finest: int, levels: int, features: int, log2_table: int) -> GridShape:
        """Return the shape with ``coarsest`` to ``finest`` cells along each axis of the unit cube, in geometric
        steps."""
        counts = np.round(np.geomspace(coarsest, finest, levels))
        return GridShape(tuple((float(c),) * 3 for c in counts), features, log2_table)

    @property
    def levels(self) -> int:
        """Number of levels."""
        return len(self.scale)

    @property
    def width(self) -> int:
        """Length of an encoding."""
        return self.levels * self.features

    def layout(self) -> tuple[list[int], list[int], list[int], list[int]]:
        """For each level its first row, number of rows, and the strides of y and z (0 where it is hashed)."""
        offsets, sizes, strides_y, strides_z, rows = [], [], [], [], 0
        for scale in self.scale:
            nx, ny, nz = (int(np.ceil(s)) + 1 for s in scale)
            dense = nx * ny * nz <= 1 << self.log2_table
            size = nx * ny * nz if dense else 1 << self.log2_table
            offsets.append(rows)
            sizes.append(size)
            strides_y.append(nx if dense else 0)
            strides_z.append(nx * ny if dense else 0)
            rows += size
        return offsets, sizes, strides_y, strides_z

    @property
    def rows(self) -> int:
        """Rows of one grid's table, all levels."""
        offsets, sizes, _, _ = self.layout()
        return offsets[-1] + sizes[-1]


class GridArrays:
    """A shape's numbers in the form that the kernels read."""

    def __init__(self, shape: GridShape) -> None:
        offsets, sizes, strides_y, strides_z = self.layout = shape.layout()
        self.shape = shape
        self.rows = shape.rows
        self.offset = np.array(offsets, np.int64)
        self.size = np.array(sizes, np.uint32)
        self.stride_y = np.array(strides_y, np.uint32)
        self.stride_z = np.array(strides_z, np.uint32)
        self.scale = np.array(shape.scale, np.float32)
        self.arrays = (self.scale, self.offset, self.size, self.stride_y, self.stride_z)
        self.struct = native.GridStruct(shape.levels, shape.features, self.rows, *(a.ctypes.data for a in self.arrays))
