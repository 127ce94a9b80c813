"""Seconds with frames beside them, in words."""

from __future__ import annotations

import numpy as np

from unisim_blender.editing.motion.braking import Approach
from unisim_blender.editing.motion.retiming import duration, followed, instant, stretched
from unisim_blender.editing.sampled.clock import Clock

CLOCK = Clock(np.arange(81.0), np.arange(81.0) / 10)


def test_seconds_have_frames_beside_them() -> None:
    assert instant(-1e-9, CLOCK) == "0.00 s (frame 0)"
    assert instant(1.2, CLOCK) == "1.20 s (frame 12)" and duration(0.5, CLOCK) == "0.50 s (5.0 frames)"


def test_following_a_curve() -> None:
    way = Approach(40.0, 8.0, 2.0)
    lines = followed(way, 0.5, CLOCK)
    assert lines == ["40.0 m take 7.00 s (70.0 frames)", "From 0.50 s (frame 5) to 7.50 s (frame 75)"]
    assert followed(way, 6.0, CLOCK)[2:] == ["The log ends at 8.00 s (frame 80)", "24.0 m before the curve's end"]
    assert followed(Approach(9.0, 8.0, 2.0), 0.0, CLOCK)[2:] == ["At 6.0 m/s, to stop at the end"]


def test_stretching() -> None:
    assert stretched(1.0, 3.0, 0.5, CLOCK) == [
        "From 1.00 s (frame 10) to 3.00 s (frame 30)",
        "2.00 s (20.0 frames) become 4.00 s (40.0 frames)",
        "Everything after that is 2.00 s (20.0 frames) later",
    ]
    assert stretched(1.0, 3.0, 2.0, CLOCK)[-1] == "Everything after that is 1.00 s (10.0 frames) earlier"
