"""The Intelligent Driver Model's formula: values of another implementation, hand-worked cases, extremes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unisim_blender.core.simulation.actors.follow import HARDEST_M_S2, IdmParameters, PathProgress, advanced
from unisim_blender.core.simulation.actors.lead import Lead
from unisim_blender.core.world.actor_path import ActorPath

DRIVERS = (IdmParameters(), IdmParameters(1.6, 2.0, 0.73, 1.67), IdmParameters(1.5, 10.0, 3.0, 5.0))
TABLE = (
    (0, 0.0, 10.0, None, 0.0, 0.0, 1.0),
    (0, 0.0, 10.0, 1.0, 0.0, 0.0, 0.0),
    (0, 0.0, 10.0, 0.005, 0.0, 0.0, -9999.0),
    (0, 10.0, 10.0, 20.0, 10.0, 0.0, -0.6400000000000001),
    (0, 10.0, 10.0, 20.0, 0.0, 0.0, -6.5934271247461895),
    (0, 60.0, 30.0, 5.0, 0.0, 0.0, -74412.16726066849),
    (0, 60.0, 10.0, 300.0, 60.0, 0.0, -1295.092011111111),
    (0, 12.0, 13.0, 25.0, 8.0, 0.5, -2.3021204113887483),
    (0, 12.0, 13.0, 25.0, 8.0, 3.1, -16.97292227666433),
    (1, 0.0, 10.0, None, 0.0, 0.0, 0.73),
    (1, 0.0, 10.0, 1.0, 0.0, 0.0, -2.19),
    (1, 0.0, 10.0, 0.005, 0.0, 0.0, -29199.27),
    (1, 10.0, 10.0, 20.0, 10.0, 0.0, -0.5913),
    (1, 10.0, 10.0, 20.0, 0.0, 0.0, -7.309011838703303),
    (1, 60.0, 30.0, 5.0, 0.0, 0.0, -87226.39459922747),
    (1, 60.0, 10.0, 300.0, 60.0, 0.0, -945.4278991111112),
    (1, 12.0, 13.0, 25.0, 8.0, 0.5, -2.5201306169364486),
    (1, 12.0, 13.0, 25.0, 8.0, 3.1, -19.492275070240524),
    (2, 0.0, 10.0, None, 0.0, 0.0, 3.0),
    (2, 0.0, 10.0, 1.0, 0.0, 0.0, -297.0),
    (2, 0.0, 10.0, 0.005, 0.0, 0.0, -2999997.0),
    (2, 10.0, 10.0, 20.0, 10.0, 0.0, -4.6875),
    (2, 10.0, 10.0, 20.0, 0.0, 0.0, -10.77872918275927),
    (2, 60.0, 30.0, 5.0, 0.0, 0.0, -38319.19203707736),
    (2, 60.0, 10.0, 300.0, 60.0, 0.0, -3885.3333333333335),
    (2, 12.0, 13.0, 25.0, 8.0, 0.5, -5.300412163778621),
    (2, 12.0, 13.0, 25.0, 8.0, 3.1, -15.871669606771624),
    (0, 25.48, 11.52, 5.4, 0.66, 1.88, -2533.4410492489706),
    (1, 36.51, 24.66, 87.67, 21.74, 2.61, -92.85906231983294),
    (2, 32.63, 1.11, 102.96, 1.34, 1.38, -2240263.7229196173),
    (0, 7.03, 34.66, 65.2, 11.99, -0.46, 0.9970471734612121),
    (2, 15.35, 39.89, 117.71, 27.42, 0.9, 2.743655389239114),
    (0, 27.54, 16.17, 16.64, 28.86, 0.15, -11.25546330456601),
    (2, 22.86, 13.55, 71.52, 13.52, -0.65, -25.056218053869912),
    (0, 35.61, 9.86, 74.97, 3.36, 2.0, -217.30416096497228),
    (1, 31.48, 10.34, 105.24, 2.34, -0.98, -77.33413710405345),
    (2, 6.01, 18.56, 95.66, 9.23, -2.69, 2.6695635965955837),
)
"""What ``IDMVehicle.acceleration`` of highway-env 1.12.1 (MIT) returns on a straight lane: driver, speed, desired speed, gap,
the lead's speed and its heading relative to the lane, acceleration. Its gaps are those of centres; the driver's gap at rest
has been set to the one used here."""


def ours(row: tuple[float | None, ...]) -> float:
    driver, speed, desired, gap, lead, turned, _ = row
    assert driver is not None and speed is not None and desired is not None and lead is not None and turned is not None
    return DRIVERS[int(driver)].acceleration(speed, desired, gap, lead * math.cos(turned))


@pytest.mark.parametrize("row", TABLE)
def test_values_of_another_implementation(row: tuple[float | None, ...]) -> None:
    assert ours(row) == pytest.approx(row[-1], rel=1e-12, abs=1e-6)


def test_against_another_implementation_itself() -> None:
    """At random; where a lead drives off so fast that the wanted gap would fall below that at rest, the two differ on purpose."""
    behavior = pytest.importorskip("highway_env.vehicle.behavior")
    road = pytest.importorskip("highway_env.road.road")
    lane = pytest.importorskip("highway_env.road.lane")
    network = road.RoadNetwork()
    network.add_lane("a", "b", lane.StraightLane([0, 0], [5000, 0], speed_limit=None))
    there = road.Road(network, np_random=np.random.RandomState(0))
    rng, compared = np.random.default_rng(1), 0
    for driver in DRIVERS:
        kind = type("Kind", (behavior.IDMVehicle,), {
            "TIME_WANTED": driver.headway_s, "DISTANCE_WANTED": driver.gap_m, "DELTA": driver.exponent,
            "COMFORT_ACC_MAX": driver.acceleration_m_s2, "COMFORT_ACC_MIN": -driver.braking_m_s2,
        })  # fmt: skip
        for _ in range(50):
            speed, desired, gap, lead = rng.uniform([0, 0.5, 0.1, 0], [60, 40, 150, 60]).tolist()
            wanted = driver.headway_s * speed + speed * (speed - lead) / 2 / math.sqrt(
                driver.acceleration_m_s2 * driver.braking_m_s2
            )
            if wanted < 0:
                continue
            own = kind(there, [100.0, 0.0], 0.0, speed, target_speed=desired)
            front = kind(there, [100.0 + gap, 0.0], 0.0, lead)
            value = driver.acceleration(speed, desired, gap, lead)
            assert value == pytest.approx(float(own.acceleration(own, front)), rel=1e-9, abs=1e-6)
            compared += 1
    assert compared > 50


def test_the_wanted_gap_is_never_below_that_at_rest() -> None:
    """Where the formula of 2000 turns negative, its square would brake for a lead that drives away."""
    driver = IdmParameters()
    assert driver.desired_gap(10.0, 30.0) == driver.gap_m
    free = driver.free_acceleration(10.0, 20.0)
    assert driver.acceleration(10.0, 20.0, 50.0, 30.0) == pytest.approx(free - (1.0 / 50) ** 2)


def test_equilibrium() -> None:
    """At the equilibrium gap (s0 + v T) / sqrt(1 - (v / v0)^4) nobody accelerates."""
    driver = IdmParameters()
    for speed in (0.0, 3.0, 9.0, 14.0):
        gap = (driver.gap_m + speed * driver.headway_s) / math.sqrt(1 - (speed / 15.0) ** 4)
        assert driver.acceleration(speed, 15.0, gap, speed) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("speed", [0.0, 1e-9, 1.0, 60.0])
@pytest.mark.parametrize("gap", [-1e6, -3.0, 0.0, 1e-12, 0.5, 1e6, None])
@pytest.mark.parametrize("lead", [-60.0, 0.0, 60.0])
@pytest.mark.parametrize("desired", [0.0, 0.5, 60.0])
def test_extremes_are_finite_and_braking_is_bounded(
    speed: float, gap: float | None, lead: float, desired: float
) -> None:
    driver = IdmParameters()
    assert math.isfinite(driver.acceleration(speed, desired, gap, lead))
    path = ActorPath.straight((0.0, 0.0, 0.0), 0.0, 100.0).at_speed(desired)
    before = PathProgress(path, 10.0, speed)
    for step_us in (1, 10_000, 100_000, 500_000):
        ahead = None if gap is None else Lead("other", gap, lead)
        after = advanced(before, driver, ahead, 0, step_us)
        dt = step_us / 1e6
        assert 0 <= after.speed_m_s <= speed + driver.acceleration_m_s2 * dt + 1e-12
        assert after.speed_m_s >= speed - HARDEST_M_S2 * dt - 1e-9
        assert -1e-12 <= after.s_m - before.s_m <= max(speed, after.speed_m_s) * dt + 1e-9


def test_a_step_does_not_depend_much_on_its_length() -> None:
    """Ten seconds behind a lead that stands: steps of 10 ms and of 500 ms come to rest at the same place."""
    driver, path = IdmParameters(), ActorPath.straight((0.0, 0.0, 0.0), 0.0, 1000.0).at_speed(12.0)
    ends = []
    for step_us in (10_000, 100_000, 500_000):
        progress = PathProgress(path, 0.0, 12.0)
        for index in range(30_000_000 // step_us):
            progress = advanced(progress, driver, Lead("wall", 80.0 - progress.s_m, 0.0), index * step_us, step_us)
        ends.append(progress.s_m)
    assert max(ends) - min(ends) < 0.02
    assert ends[0] == pytest.approx(79.0, abs=0.1)
