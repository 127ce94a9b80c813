"""At which rate images of given times are played, and for how many frames of a film each is shown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

FASTEST_HZ = 240.0
"""The highest rate at which images of uneven times are played."""
EVEN = 0.02
"""Relative difference of steps from their mean up to which times count as evenly spaced."""


def playback(times_s: Sequence[float], least_hz: float = 0.0) -> tuple[float, list[int]]:
    """Return a rate in frames per second, and the number of frames that each image is shown for.

    Evenly spaced times (N,), ascending, in seconds, are played at their own rate, one frame each. Other ones at a rate at
    which the shortest step lasts a frame, within ``least_hz`` and `FASTEST_HZ`: each image is shown until the time of the
    next one, the last for one frame. An image whose step is shorter than half a frame is not shown.
    """
    steps = np.diff(np.asarray(times_s, float))
    if not len(steps):
        return least_hz or 10.0, [1] * len(times_s)
    if np.ptp(steps) <= EVEN * steps.mean() and 1 / steps.mean() >= least_hz:
        return float(1 / steps.mean()), [1] * len(times_s)
    rate = float(max(min(1 / steps.min(), FASTEST_HZ), least_hz))
    ticks = np.round((np.asarray(times_s, float) - times_s[0]) * rate).astype(int)
    return rate, [*np.diff(ticks).tolist(), 1]
