"""Words for edits, without Blender's scene."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.editing.edits.lines import displaced_words, metres, moved_words, retimed_words, trajectory_words
from unisim_blender.editing.sampled.clock import Clock


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw_deg: float = 0.0) -> FloatArray:
    """A displacement."""
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


@pytest.mark.parametrize(
    ("apart", "words"),
    [
        (pose(y=3.0), "3.0 m left"),
        (pose(x=-7.0, y=0.1), "7.0 m back"),
        (pose(x=1.0, y=-2.0), "1.0 m forward, 2.0 m right"),
        (pose(z=0.03), "0.03 m up"),
        (pose(yaw_deg=-20.0), "turned 20° right"),
        (pose(x=1.0, yaw_deg=0.44), "1.0 m forward, turned 0.4° left"),
    ],
)
def test_displacements(apart: FloatArray, words: str) -> None:
    assert moved_words(apart) == words


def test_displacements_of_many_frames() -> None:
    assert displaced_words(np.stack([pose()] * 3)) == ""
    assert displaced_words(np.stack([pose(y=2.0)] * 3)) == "Moved 2.0 m left"
    assert displaced_words(np.stack([pose(), pose(y=-1.0), pose(y=-3.5)])) == "Moved by up to 3.5 m right"
    assert displaced_words(np.stack([pose(), pose(x=3.0, y=4.0)])) == "Moved by up to 5.0 m"
    assert displaced_words(np.stack([pose(), pose(yaw_deg=5)])) == "Turned"
    assert metres(0.0004) == "0.4 mm"


def path(times_s: FloatArray) -> FloatArray:
    """A bend, driven ever faster."""
    along = 5 * times_s + times_s**2
    return np.stack([pose(10 * np.sin(a / 10), 10 - 10 * np.cos(a / 10), 0.7, np.degrees(a / 10)) for a in along])


def test_delays() -> None:
    times = np.linspace(0, 4, 41)
    recorded = Trajectory.from_poses(times, path(times))
    for delay, words in ((0.6, "Retimed: 0.6 s later"), (-0.3, "Retimed: 0.3 s earlier")):
        inside = times[(times - delay >= 0) & (times - delay <= 4)]
        assert retimed_words(inside, path(inside - delay)[:, :3, 3], recorded) == words
    slower = np.where(times > 1, 1 + (times - 1) / 2, times)
    assert retimed_words(times, path(slower)[:, :3, 3], recorded) == "Retimed: up to 1.5 s later"
    beside = path(times - 0.6) @ pose(y=1.0)
    assert retimed_words(times, beside[:, :3, 3], recorded) == ""


def test_trajectories() -> None:
    times = np.linspace(0, 4, 41)
    clock, base = Clock(np.arange(41.0), times), path(times)
    recorded = Trajectory.from_poses(times, base)
    assert trajectory_words(clock, base, base, recorded, False) == ""
    assert trajectory_words(clock, recorded.at(times - 0.5), base, recorded, True) == "Retimed: 0.5 s later"
    assert trajectory_words(clock, path(times - 0.5), base, recorded, False).startswith("New trajectory, up to ")
    assert trajectory_words(clock, np.stack([base[0]] * 41), base, recorded, False) == "Stands still"
    assert trajectory_words(clock, pose(x=0.0, y=2.0) @ base, base, recorded, False) == "Moved 2.0 m left"
