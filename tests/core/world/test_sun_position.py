"""Where the sun stands by place and time, and how a recording's world is turned."""

from __future__ import annotations

from datetime import datetime, timezone

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.world.light import EARTH_M, recorded_sun, sun_over

GOLDEN = 39.742476, -105.1786
NOON_S = datetime(2003, 10, 17, 19, 30, 30, tzinfo=timezone.utc).timestamp()


def test_the_sun_stands_where_the_reference_algorithm_has_it() -> None:
    # the example of Reda and Andreas, Solar Position Algorithm, NREL/TP-560-34302: azimuth from north, zenith
    azimuth_deg, elevation_deg = sun_over(*GOLDEN, NOON_S)
    assert (90 - azimuth_deg) % 360 == pytest.approx(194.34024, abs=0.05)
    assert elevation_deg == pytest.approx(90 - 50.11162, abs=0.05)


def drive(turn_deg: float, length_m: float) -> tuple[FloatArray, FloatArray]:
    """Latitudes and longitudes of a drive eastward that turns north, and its positions in a world turned by an angle."""
    east, north = length_m * np.linspace(0, 1, 50), length_m * np.linspace(0, 1, 50) ** 2
    degrees = np.degrees(np.stack([north / EARTH_M, east / EARTH_M / np.cos(np.radians(GOLDEN[0]))], -1)) + GOLDEN
    turned = (east + 1j * north) * np.exp(1j * np.radians(turn_deg)) + (3 - 4j)
    return degrees, np.stack([turned.real, turned.imag, np.zeros(50)], -1)


def test_a_turned_world_turns_the_sun_and_noise_is_said() -> None:
    azimuth_deg, elevation_deg = sun_over(*GOLDEN, NOON_S)
    for turn_deg in (0.0, 70.0):
        sun = recorded_sun(*drive(turn_deg, 40.0), NOON_S)
        assert sun is not None and sun.deviation_deg == pytest.approx(0.3, abs=0.02)
        assert (sun.azimuth_deg, sun.elevation_deg) == pytest.approx((azimuth_deg + turn_deg, elevation_deg), abs=0.02)
    degrees, positions = drive(0.0, 40.0)
    noisy = recorded_sun(degrees, positions + np.random.default_rng(0).normal(0, 2, positions.shape), NOON_S)
    assert noisy is not None and noisy.deviation_deg > 5
    assert abs(noisy.azimuth_deg - azimuth_deg) < noisy.deviation_deg


def test_nothing_is_said_of_a_drive_too_short_and_of_a_night() -> None:
    assert recorded_sun(*drive(0.0, 5.0), NOON_S) is None
    assert recorded_sun(*drive(0.0, 40.0), NOON_S + 12 * 3600) is None
