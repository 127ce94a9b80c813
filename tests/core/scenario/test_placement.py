"""Rotations as a scenario states them: unit quaternions keep their bits, others are made unit length."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.scenario.motion.placement import Placement, rotations_of, unit_quaternions


def test_a_unit_quaternion_keeps_its_bits() -> None:
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(1000, 4))
    unit /= np.sqrt((unit * unit).sum(1, keepdims=True))
    again = unit / np.sqrt((unit * unit).sum(1, keepdims=True))
    assert (again != unit).any(), "rounding once more would change none"
    np.testing.assert_array_equal(unit_quaternions(unit), unit)


def test_one_written_by_hand_is_made_unit_length() -> None:
    given = [Placement(position=(0, 0, 0), quaternion_wxyz=(0.7071, 0.0, 0.0, 0.7071))]
    (found,) = rotations_of(given)
    np.testing.assert_allclose(found, np.sqrt([0.5, 0, 0, 0.5]), atol=1e-15)
