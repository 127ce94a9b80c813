"""When sensors capture in a simulation, and where keys lie."""

from __future__ import annotations

import dataclasses

import pytest
from tiny_drive import tiny_drive

from unisim_blender.core.simulation.clock import CLOSING_US, Rate, exposures, key_times, recorded_rate
from unisim_blender.core.world.drive import RollingShutter


def test_captures_follow_their_period_and_phase() -> None:
    times = Rate(33_000, 5_000).from_time(100_000)
    assert [next(times) for _ in range(3)] == [104_000, 137_000, 170_000]
    before = Rate(100_000, 700_000).from_time(-150_000)
    assert next(before) == -100_000
    with pytest.raises(ValueError, match="above 0, not 0 us"):
        Rate(0)


def test_a_sensor_goes_on_as_it_was_recorded() -> None:
    assert recorded_rate(tiny_drive().lidars["top"]) == Rate(100_000, 0)


def test_exposures_lie_within_the_simulation_by_their_ends() -> None:
    """A sweep takes the 0.1 s before its time; sums of tenths that are no whole microseconds count as these."""
    drive = tiny_drive(8)
    shutter = RollingShutter(0.02, 0.5)
    camera = drive.cameras["front"]
    slow = dataclasses.replace(camera, model=dataclasses.replace(camera.model, shutter=shutter))
    drive = dataclasses.replace(drive, cameras={"front": slow})
    found = exposures(drive, {"front": Rate(50_000), "top": Rate(100_000)}, 100_000, 400_000)
    sweeps = [one for one in found if one.capture.sensor_id == "top"]
    assert [(one.start_us, one.end_us) for one in sweeps] == [
        (100_000, 200_000),
        (200_000, 300_000),
        (300_000, 400_000),
    ]
    images = [one for one in found if one.capture.sensor_id == "front"]
    assert [one.capture.time_us for one in images] == [150_000, 200_000, 250_000, 300_000, 350_000]
    assert all(one.start_us < one.capture.time_us < one.end_us for one in images)
    assert [one.end_us for one in found] == sorted(one.end_us for one in found)
    whole = exposures(tiny_drive(8), {"top": Rate(100_000)}, 0, 700_000)
    assert len(whole) == 7 and whole[-1].end_us == 700_000


def test_keys_lie_where_exposures_start_and_end() -> None:
    drive = tiny_drive(4)
    during = exposures(drive, {"top": Rate(100_000, 37_000)}, 0, 300_000)
    assert [(one.start_us, one.end_us) for one in during] == [(37_000, 137_000), (137_000, 237_000)]
    times = key_times(100_000, 200_000, during)
    assert {137_000, 137_000 + CLOSING_US, 110_000, 190_000, 200_000} <= set(times)
    assert times == sorted(times) and times[0] > 100_000 and times[-1] == 200_000
    ends = key_times(137_000, 237_000, during)
    assert ends[-2:] == [237_000, 237_000 + CLOSING_US], "the last exposure's end is closed behind the step"
