"""Ray drop: how often recorded beams came back, by how far they went, how steeply they hit a surface, and
how bright it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....geometry import BoolArray, FloatArray

Bins = NDArray[np.int64]

RANGES_M = np.array([5.0, 10, 20, 30, 45, 60, 80, 100, 130, 160])
COSINES = np.array([0.05, 0.1, 0.2, 0.4, 0.7])
INTENSITIES = np.array([0.01, 0.02, 0.04, 0.08, 0.16, 0.4])
PRIOR = 20.0
"""Beams in a bin count beside so many that returned as all do on average."""


@dataclass(frozen=True, eq=False)
class DropTable:
    """returns and beams (ranges, cosines, intensities): of so many recorded beams that hit such a surface,
    so many returned."""

    returns: FloatArray
    beams: FloatArray

    @staticmethod
    def empty() -> DropTable:
        """Of no beam at all: what hits something returns."""
        shape = tuple(len(edges) + 1 for edges in (RANGES_M, COSINES, INTENSITIES))
        return DropTable(np.zeros(shape), np.zeros(shape))

    def counted(self, depth_m: FloatArray, cosine: FloatArray, intensity: FloatArray, returned: BoolArray) -> DropTable:
        """The table with more beams (N,) in it."""
        bins, shape = _bins(depth_m, cosine, intensity), self.beams.shape
        size = int(np.prod(shape))
        flat = np.ravel_multi_index(bins, shape)
        returns = np.bincount(flat, returned.astype(np.float64), size).reshape(shape)
        return DropTable(self.returns + returns, self.beams + np.bincount(flat, minlength=size).reshape(shape))

    def probability(self, depth_m: FloatArray, cosine: FloatArray, intensity: FloatArray) -> FloatArray:
        """How likely beams (N,) return that hit a surface at such a depth, cosine of incidence and intensity."""
        average = (self.returns.sum() + 1) / (self.beams.sum() + 1)
        share = (self.returns + PRIOR * average) / (self.beams + PRIOR)
        return np.asarray(share[_bins(depth_m, cosine, intensity)])


def _bins(depth_m: FloatArray, cosine: FloatArray, intensity: FloatArray) -> tuple[Bins, Bins, Bins]:
    found = (
        np.searchsorted(edges, x) for edges, x in ((RANGES_M, depth_m), (COSINES, cosine), (INTENSITIES, intensity))
    )
    a, b, c = found
    return a, b, c
