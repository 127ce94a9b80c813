"""What nothing else beats."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...geometry import BoolArray


def pareto_front(seconds: Sequence[float], errors: Sequence[float], tolerance: float = 0.0) -> BoolArray:
    """Which of N points no other beats: one that is faster and whose error is larger by ``tolerance`` at most, or one
    that is as fast and whose error is smaller by more than that. Points whose error is not finite are
    not on the front."""
    t, e = np.array(seconds, float), np.array(errors, float)
    with np.errstate(invalid="ignore"):
        sooner = (t[:, None] < t) & (e[:, None] <= e + tolerance)
        better = (t[:, None] <= t) & (e[:, None] < e - tolerance)
    return np.asarray(np.isfinite(e) & ~(sooner | better).any(0))
