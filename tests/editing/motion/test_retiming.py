"""Retiming: where keys go, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.editing.motion.retiming import Retiming
from unisim_blender.editing.sampled.clock import Clock

CLOCK = Clock(np.arange(81.0), np.arange(81.0) / 10)
FRAMES = np.array([0.0, 10.0, 20.0, 40.0])


def retiming(mode: str) -> Retiming:
    """Half a second, half as fast, or from 1 s to 2 s."""
    return Retiming(mode, seconds=0.5, speed=0.5, first_s=1.0, last_s=2.0)


@pytest.mark.parametrize(
    ("mode", "frames"),
    [
        ("DELAY", [5.0, 15.0, 25.0, 45.0]),
        ("SPEED", [0.0, 10.0, 30.0, 70.0]),
        ("STRETCH", [0.0, 10.0, 30.0, 50.0]),
    ],
)
def test_keys_move_to_their_new_frames(mode: str, frames: list[float]) -> None:
    assert retiming(mode).frames(CLOCK)(FRAMES) == pytest.approx(frames)


@pytest.mark.parametrize(
    ("mode", "lines", "summary"),
    [
        ("DELAY", ["0.50 s (5.0 frames) later"], "0.50 s (5.0 frames) later"),
        (
            "SPEED",
            ["From 1.00 s (frame 10) on", "1 s becomes 2.00 s (20.0 frames)"],
            "speed x0.5 from 1.00 s (frame 10) on",
        ),
        (
            "STOP",
            ["Brakes from 1.00 s (frame 10) on", "Stands for 0.50 s (5.0 frames)"],
            "stands for 0.50 s (5.0 frames)",
        ),
        (
            "STRETCH",
            [
                "From 1.00 s (frame 10) to 2.00 s (frame 20)",
                "1.00 s (10.0 frames) become 2.00 s (20.0 frames)",
                "Everything after that is 1.00 s (10.0 frames) later",
            ],
            "speed x0.5 for 1.00 s (10.0 frames)",
        ),
    ],
)
def test_a_change_is_told_in_seconds_and_frames(mode: str, lines: list[str], summary: str) -> None:
    assert retiming(mode).lines(CLOCK) == lines
    assert retiming(mode).summary(CLOCK) == summary


def test_a_stop_of_negative_length_is_as_long() -> None:
    assert Retiming("STOP", -0.5, 1.0, 0.0, 0.0).summary(CLOCK) == "stands for 0.50 s (5.0 frames)"
