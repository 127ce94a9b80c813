"""Trajectories along a drawn line, keys shifted along a path, and times of handles."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import matrix_from_quaternion, quaternion_from_yaw
from unisim_blender.editing.motion.keys import (
    HANDLE_LIMIT,
    along_line,
    handle_times,
    shifted_keys,
)


def test_along_a_straight_line() -> None:
    line = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 10.0, 1.0]])  # a point twice
    lengths, positions, quaternions = along_line(line, np.array([0.0, 3.0, 6.0, 9.0, 10.0]), 1.5)
    assert lengths == pytest.approx([0.0, 3.0, 6.0, 9.0, 10.0])
    assert positions == pytest.approx(np.stack([np.zeros(5), lengths, np.full(5, 1.75)], -1))
    axes = matrix_from_quaternion(quaternions)
    assert axes[:, :, 0] == pytest.approx(np.tile([0.0, 1.0, 0.0], (5, 1))), "its front is ahead"
    assert axes[:, :, 2] == pytest.approx(np.tile([0.0, 0.0, 1.0], (5, 1)))


def test_up_a_slope_its_underside_is_on_the_line() -> None:
    line = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 3.0]])
    _, positions, quaternions = along_line(line, np.arange(6.0), 2.0)
    axes = matrix_from_quaternion(quaternions)
    under = positions - axes[:, :, 2] * 1.0
    assert np.linalg.norm(np.cross(under, line[1] / 5), axis=1) == pytest.approx(np.zeros(len(under)), abs=1e-9)
    assert axes[:, 2, 1] == pytest.approx(np.zeros(len(under))), "its left side is level"


def test_keys_shifted_along_a_path_follow_its_turns() -> None:
    """With keys at its ends and its corner alone, what lies between them is shifted round the corner too."""
    frames = np.array([0.0, 10.0, 20.0])
    positions = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0]])
    turns = quaternion_from_yaw(np.array([0.0, np.pi / 4, np.pi / 2]))
    every, moved, quaternions = shifted_keys(frames, positions, turns, np.arange(21.0), 2.0)
    assert every.tolist() == list(range(21))
    assert moved[5] == pytest.approx([7.0, 0.0, 0.0]) and moved[9] == pytest.approx([10.0, 1.0, 0.0])
    assert moved[20] == pytest.approx([10.0, 12.0, 0.0]), "straight on beyond the end"
    assert np.linalg.norm(quaternions, axis=1) == pytest.approx(np.ones(21))


@pytest.mark.parametrize(("span", "step"), [((0.0, 8.0), 1.0), ((0.5, 40.0), 2.0), ((0.0, 900.0), 60.0)])
def test_handles_are_at_round_times(span: tuple[float, float], step: float) -> None:
    found = handle_times(np.zeros(0), span)
    times = np.array([time for time, _ in found])
    assert 1 < len(times) <= HANDLE_LIMIT + 1 and not any(is_key for _, is_key in found)
    assert (
        np.diff(times) == pytest.approx(np.full(len(times) - 1, step)) and times[0] >= span[0] and times[-1] <= span[1]
    )


def test_keys_have_handles_and_seconds_near_them_have_none() -> None:
    found = handle_times(np.array([2.1, 5.5, 2.1, 99.0]), (0.0, 6.0))
    assert [time for time, is_key in found if is_key] == [2.1, 5.5], "one each, while it is present"
    assert [time for time, is_key in found if not is_key] == [0.0, 1.0, 3.0, 4.0, 5.0, 6.0]
