"""Frames of a Blender scene and captures, in both directions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.scenario.types import FrameRange
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import Camera, Drive, Lidar
from unisim_blender.editing.sampled.clock import Clock

SCENE = Path(__file__).parents[3] / "sample" / "scene"


@pytest.fixture(scope="module")
def drive() -> Drive:
    return read_scene_header(SCENE).drive


@pytest.fixture(scope="module")
def sparse(drive: Drive) -> Camera:
    """A camera that took every third image, 50 ms before the frames' times."""
    camera = drive.cameras["front_camera"]
    return replace(camera, time_s={frame: time_s for frame, time_s in camera.time_s.items() if frame % 3 == 0})


def test_a_frame_of_the_log_is_its_capture_and_back(drive: Drive) -> None:
    clock = Clock.of(drive)
    sensors: list[Camera | Lidar] = [*drive.cameras.values(), *drive.lidars.values()]
    for sensor in sensors:
        for frame in drive.frames:
            capture = clock.capture(sensor, float(frame))
            assert capture == Capture.of_frame(sensor, frame)
            assert capture.time_s(sensor) == sensor.time_s[frame], "to the bit"
            assert clock.frame_of(sensor, capture) == frame


def test_between_frames_and_outside_there_are_captures_too(drive: Drive, sparse: Camera) -> None:
    clock = Clock.of(drive)
    sensors: list[Camera | Lidar] = [*drive.cameras.values(), *drive.lidars.values(), sparse]
    for sensor in sensors:
        for frame in (-3.0, -0.5, 0.25, 4.0, 7.5, 8.999, 18.75, 19.5, 24.0):
            capture = clock.capture(sensor, frame)
            assert clock.frame_of(sensor, capture) == pytest.approx(frame, abs=2e-5)
            delay = 0.05 if isinstance(sensor, Camera) else 0.0
            assert capture.time_s(sensor) == pytest.approx(0.1 * frame - delay, abs=1e-6)
    times = [clock.capture(sparse, frame).time_us for frame in np.linspace(-2, 22, 241)]
    assert (np.diff(times) > 0).all(), "a later frame is a later capture"
    half = clock.capture(drive.cameras["front_camera"], 9.5)
    assert half.frame is None and half.time_us == 900_000


def test_frames_at_equal_distances_are_captures_at_the_scenes_rate(drive: Drive) -> None:
    clock = Clock.of(drive)
    assert clock.rate == pytest.approx(10.0)
    lidar = drive.lidars["pandar64"]
    steps = np.diff([clock.capture(lidar, frame).time_us for frame in np.arange(0, 19, 0.25)])
    assert (np.abs(steps - 1e6 / clock.rate / 4) <= 1).all()


def test_the_scenes_range_and_step_are_the_logs(drive: Drive) -> None:
    clock = Clock.of(drive)
    assert clock.frame_range(0, 19, 1) is None and clock.frame_range(-5, 250, 1) is None
    assert clock.frame_range(0, 19, 2) == FrameRange(0, 20, 2)
    assert clock.frame_range(3, 18, 1) == FrameRange(3, 19, 1)


def test_a_log_of_one_frame_has_a_rate(drive: Drive) -> None:
    one = replace(drive, frames=(4,), time_s={4: drive.time_s[4]})
    clock = Clock.of(one)
    assert clock.rate == pytest.approx(10.0) and clock.capture(drive.lidars["pandar64"], 4.0).frame == 4
