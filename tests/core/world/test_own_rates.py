"""Sensors with rates of their own: which captures a frame of the drive has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tiny_drive import tiny_drive

from unisim_blender.core.world.own_rates import captures_of, number_captures


def test_every_stamp_has_a_number() -> None:
    """Frames at 10 Hz, a camera at 25 Hz that starts late."""
    frames = {frame: 0.1 * frame for frame in range(5)}
    stamps = (0.04 * np.arange(1, 12) + 0.003).tolist()
    found = number_captures(frames, stamps)
    assert sorted(found.values()) == stamps
    for frame, time in frames.items():
        nearest = min(stamps, key=lambda stamp: abs(stamp - time))
        assert found[frame] == nearest
    others = [number for number in found if number not in frames]
    assert others == list(range(5, 11)) and [found[n] for n in others] == sorted(found[n] for n in others)


def test_a_slow_sensor_leaves_frames_empty() -> None:
    found = number_captures({frame: 0.1 * frame for frame in range(6)}, [0.01, 0.31])
    assert found == {0: 0.01, 3: 0.31}
    assert number_captures({}, [0.5]) == {0: 0.5} and number_captures({0: 0.0}, []) == {}


def test_captures_between_frames_belong_to_the_nearest() -> None:
    drive = tiny_drive(6)
    times = number_captures(drive.time_s, (0.04 * np.arange(13)).tolist())
    camera = replace(drive.cameras["front"], time_s=times)
    drive = replace(drive, cameras={"front": camera})
    even, odd = (captures_of(times, drive, frames, times) for frames in ((0, 2, 4), (1, 3, 5)))
    assert sorted(even + odd) == sorted(times) and not set(even) & set(odd), "held out or trained on, never both"
    for numbers, frames in ((even, (0, 2, 4)), (odd, (1, 3, 5))):
        assert [times[n] for n in numbers] == sorted(times[n] for n in numbers)
        for number in numbers:
            assert (
                min(drive.frames, key=lambda frame: abs(drive.time_s[frame] - times[number])) in frames
                or number in frames
            )


def test_of_a_synchronous_sensor_the_frames_are_what_was_asked_for() -> None:
    drive = tiny_drive(6)
    assert captures_of(drive.cameras["front"].time_s, drive, (4, 0, 9, 2), (0, 1, 2)) == [0, 2]
