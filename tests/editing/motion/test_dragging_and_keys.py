"""Points under the mouse, keys as Blender interpolates them, and presence as keys."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import Trajectory, quaternion_from_yaw
from unisim_blender.editing.motion.keys import OFF_M, along_axis, continuous, dense, hidden_keys, on_plane, stepped
from unisim_blender.editing.sampled.clock import Clock

CLOCK = Clock(np.arange(5.0), np.array([0.0, 0.1, 0.2, 0.3, 0.4]))


def test_rays() -> None:
    up, origin = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 10.0])
    assert on_plane(origin, np.array([0.0, 1.0, -1.0]), np.zeros(3), up) == pytest.approx([0.0, 10.0, 0.0])
    assert on_plane(origin, np.array([0.0, 1.0, 0.0]), np.zeros(3), up) is None
    assert on_plane(origin, np.array([0.0, 0.0, 1.0]), np.zeros(3), up) is None
    assert along_axis(origin, np.array([0.3, 0.0, -1.0]), np.zeros(3), np.array([1.0, 0.0, 0.0])) == pytest.approx(3.0)
    assert stepped(1.3, 0.5, True) == 1.5 and stepped(1.3, 0.5, False) == 1.3


def test_a_straight_trajectory_keeps_its_own_keys() -> None:
    straight = Trajectory(np.array([0.0, 0.4]), np.array([[0.0, 0, 0], [4.0, 0, 0]]), quaternion_from_yaw(np.zeros(2)))
    assert dense(straight, CLOCK) is straight


@pytest.mark.parametrize("case", ["turns", "uneven frames"])
def test_keys_at_all_frames_where_blender_would_interpolate_otherwise(case: str) -> None:
    times = CLOCK.times_s + np.array([0.0, 0.03, 0.0, 0.0, 0.0]) if case == "uneven frames" else CLOCK.times_s
    clock = Clock(CLOCK.frames, times)
    yaw = np.array([0.0, 1.0]) if case == "turns" else np.zeros(2)
    recorded = Trajectory(np.array([0.0, 0.4]), np.array([[0.0, 0, 0], [4.0, 0, 0]]), quaternion_from_yaw(yaw))
    found = dense(recorded, clock)
    assert found.times_s == pytest.approx(times)
    frames = clock.frame(found.times_s)
    made = np.stack([np.interp(clock.frames, frames, column) for column in found.positions.T], -1)
    assert np.abs(made - recorded.at(times)[:, :3, 3]).max() < OFF_M


def test_quaternions_do_not_jump_to_their_negatives() -> None:
    turns = quaternion_from_yaw(np.linspace(0, 6, 13)) * np.where(np.arange(13) % 3 == 1, -1.0, 1.0)[:, None]
    found = continuous(turns)
    assert ((found[1:] * found[:-1]).sum(-1) > 0).all() and np.abs(found) == pytest.approx(np.abs(turns))


@pytest.mark.parametrize(
    ("span", "frames", "hidden"),
    [
        ((0.1, 0.2), [-1, 1, 3], [1, 0, 1]),
        ((0.0, 0.2), [-1, 0, 3], [1, 0, 1]),
        ((0.3, 9.0), [-1, 3, 5], [1, 0, 1]),
        ((7.0, 9.0), [-1], [1]),
    ],
)
def test_presence_as_keys(span: tuple[float, float], frames: list[float], hidden: list[float]) -> None:
    found = hidden_keys(CLOCK, span)
    assert found is not None and found[0].tolist() == frames and found[1].tolist() == hidden


def test_presence_throughout_needs_no_keys() -> None:
    assert hidden_keys(CLOCK, None) is None and hidden_keys(CLOCK, (-1.0, 1.0)) is None
