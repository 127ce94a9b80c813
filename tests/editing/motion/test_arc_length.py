"""Trajectories shifted along their path by arc length."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray, quaternion_from_yaw
from unisim_blender.core.scenario.motion.paths import is_path, shifted_along


def arc(angles: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Positions (K, 3) and quaternions (K, 4) on a circle that turns left."""
    positions = np.stack([radius_m * np.sin(angles), radius_m * (1 - np.cos(angles)), np.zeros_like(angles)], -1)
    return positions, quaternion_from_yaw(angles)


def test_round_a_circle() -> None:
    angles = np.linspace(0, 1.2, 80)
    positions, quaternions = shifted_along(*arc(angles, 12.0), 3.0)
    expected, turned = arc(angles + 3.0 / 12.0, 12.0)
    on_path = angles + 3.0 / 12.0 < 1.2
    assert np.abs(positions - expected)[on_path].max() < 0.01
    assert np.abs(quaternions - turned)[on_path].max() < 0.01
    assert np.linalg.norm(positions[-1] - arc(np.array([1.2]), 12.0)[0][0]) == pytest.approx(
        3.0, abs=1e-6
    )  # straight on


def test_backward_and_forth_again() -> None:
    path = arc(np.linspace(0, 1.2, 80), 12.0)
    there = shifted_along(*shifted_along(*path, -2.0), 2.0)
    assert np.abs(there[0] - path[0])[10:-14].max() < 0.02  # at both ends the path was left, straight on


def test_what_stands_and_wanders_is_not_led_astray() -> None:
    rng = np.random.default_rng(0)
    along = np.concatenate([np.zeros(30), np.linspace(0, 20, 30), np.full(30, 20.0)])
    positions = np.stack([along, np.zeros(90), np.zeros(90)], -1) + 0.02 * rng.standard_normal((90, 3))
    moved, _ = shifted_along(positions, np.tile([1.0, 0, 0, 0], (90, 1)), 5.0)
    assert (moved - positions)[:, 0] == pytest.approx(np.full(90, 5.0), abs=0.15)
    assert not is_path(positions[:30])
    with pytest.raises(ValueError, match="stands still"):
        shifted_along(positions[:30], np.tile([1.0, 0, 0, 0], (30, 1)), 1.0)
