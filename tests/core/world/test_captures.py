"""Captures: names of files that sort by time, seeds that follow from what is captured, and which captures
belong together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tiny_drive import tiny_drive

from unisim_blender.core.world.captures import (
    MAX_TIME_US,
    Capture,
    Moment,
    frame_name,
    in_order,
    key_of,
    microseconds,
    moments_of,
    name_of,
    time_name,
    time_of_name,
)

DRIVE = tiny_drive()


def test_names_sort_by_time_after_those_of_frames_and_read_back() -> None:
    rng = np.random.default_rng(0)
    times = sorted({*rng.integers(-(10**9), 10**9, 500).tolist(), -MAX_TIME_US + 1, -1, 0, 1, MAX_TIME_US - 1})
    names = [time_name(time) for time in times]
    assert names == sorted(names) and len(set(names)) == len(times)
    assert [time_of_name(name) for name in names] == times
    assert all(key_of(name) == name and name_of(name) == name for name in names)
    frames = [frame_name(frame) for frame in (0, 7, 999_999, 1_000_000)]
    assert frames == ["000000", "000007", "999999", "1000000"] and [key_of(name) for name in frames] == [
        0,
        7,
        999_999,
        1_000_000,
    ]
    assert max(frames) < min(names)
    assert in_order([names[3], 12, names[0], 2]) == [2, 12, names[0], names[3]]


@pytest.mark.parametrize(
    "name", ("", "000012a", "t12us", "t0000000000012", "x0000000000012us", "t00000000000123us", "12.json")
)
def test_other_names_are_nobodys(name: str) -> None:
    with pytest.raises(ValueError):
        key_of(name)


def test_a_time_that_is_a_frames_is_that_frame() -> None:
    camera = DRIVE.cameras["front"]
    capture = Capture.at(camera, 300_000)
    assert capture == Capture.of_frame(camera, 3) and capture.frame == 3
    # 0.1 * 3 is not 0.3: the frame's own timestamp counts, to the bit
    assert capture.time_s(camera) == camera.time_s[3] != 0.3
    between = Capture.at(camera, 300_001)
    assert between.frame is None and between.time_s(camera) == 0.300001


def test_seeds_are_those_of_frames_and_differ_between_times_and_sensors() -> None:
    assert Capture("top", 300_000, 3).seed(7) == [7, 3, *b"top"], "what log frames were drawn from must not change"
    captures = [Capture(name, time) for name in ("top", "to", "p") for time in (-1, 0, 1, 3, 2**33, -(2**33))]
    captures += [Capture("top", 100_000 * frame, frame) for frame in range(6)]
    draws = {np.random.default_rng(capture.seed(7)).random(4).tobytes() for capture in captures}
    assert len(draws) == len(captures)
    assert Capture("top", 5).seed(7) == Capture("top", 5).seed(7) != Capture("top", 5).seed(8)


def test_moments_of_frames_leave_out_sensors_that_lack_them() -> None:
    camera = replace(DRIVE.cameras["front"], time_s={frame: 0.1 * frame for frame in range(5)})
    moments = moments_of(replace(DRIVE, cameras={"front": camera}), (4, 5), None, ["front"], ["top"])
    assert [(one.key, one.name, len(one.cameras), len(one.lidars)) for one in moments] == [
        (4, "000004", 1, 1),
        (5, "000005", 0, 1),
    ]
    assert moments[0].time_s(DRIVE) == DRIVE.time_s[4]


def test_several_rates_in_one_drive() -> None:
    thirty = tuple(round(i * 1e6 / 30) for i in range(6))
    moments = moments_of(DRIVE, DRIVE.frames, (0, 100_000), ["front"], ["top"], {"camera/front": thirty})
    assert [one.time_us for one in moments] == [0, 33_333, 66_667, 100_000, 133_333, 166_667]
    assert [(len(one.cameras), len(one.lidars)) for one in moments] == [(1, 1), (1, 0), (1, 0), (1, 1), (1, 0), (1, 0)]
    assert all(one.name == time_name(one.time_us) and one.frame is None for one in moments)
    mixed = moments_of(DRIVE, (0, 1), None, ["front"], ["top"], {"camera/front": (50_000,)})
    assert [(one.key, len(one.cameras), len(one.lidars)) for one in mixed] == [
        (0, 0, 1),
        (1, 0, 1),
        ("t0000000050000us", 1, 0),
    ]
    assert [one.key for one in moments_of(DRIVE, (0, 1), None, [], [])] == [0, 1], "labels alone"
    alone = moments_of(DRIVE, (0, 1), None, ["front"], [], {"camera/front": (50_000,)})
    assert [one.key for one in alone] == ["t0000000050000us"]


def test_microseconds_round_to_the_nearest() -> None:
    assert [microseconds(x) for x in (0.1 * 3, 1.0000005001, -0.05)] == [300_000, 1_000_001, -50_000]
    assert Moment.at(DRIVE, 250_000, ["front"], []).time_s(DRIVE) == 0.25
