"""Sensors with rates of their own: images and sweeps between the frames of the drive.

A sensor's ``time_s`` numbers its captures. Those with the number of a frame of the drive are that frame's; all others,
with numbers that no frame has, lie between frames, and belong to the frame that is nearest in time: with it they are
trained on or held out.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from .drive import Drive


def number_captures(frame_times_s: Mapping[int, float], stamps_s: Sequence[float]) -> dict[int, float]:
    """Return a sensor's ``time_s`` of all its stamps: each frame has the stamp nearest to it, at most half a frame
    away, and the others are numbered on from the last frame's number, in the order of time."""
    stamps, frames = np.sort(np.asarray(stamps_s, np.float64)), sorted(frame_times_s)
    if not frames or not len(stamps):
        return dict(enumerate(stamps.tolist(), 1 + max(frames, default=-1)))
    times = np.array([frame_times_s[frame] for frame in frames])
    half = float(np.median(np.diff(times))) / 2 if len(times) > 1 else np.inf
    nearest = _nearest(times, stamps)
    time_s: dict[int, float] = {}
    taken: set[int] = set()
    for frame, time, at in zip(frames, times, nearest.tolist(), strict=True):
        if abs(stamps[at] - time) <= half and at not in taken:
            taken.add(at)
            time_s[frame] = float(stamps[at])
    others = [float(stamp) for at, stamp in enumerate(stamps) if at not in taken]
    return time_s | dict(enumerate(others, frames[-1] + 1))


def captures_of(time_s: Mapping[int, float], drive: Drive, frames: Sequence[int], there: Collection[int]) -> list[int]:
    """Return the numbers of a sensor's captures, of those that are ``there``, that belong to some frames of the drive,
    by time; in the order of ``frames`` where the sensor has no other."""
    chosen, have = set(frames), set(there)
    own = [frame for frame in frames if frame in have]
    between = sorted(
        (number for number in have if number not in drive.time_s and number in time_s), key=time_s.__getitem__
    )
    if not between:
        return own
    order = np.array(drive.frames)
    times = np.array([drive.time_s[frame] for frame in drive.frames])
    nearest = order[_nearest(np.array([time_s[number] for number in between]), times)].tolist()
    more = [number for number, frame in zip(between, nearest, strict=True) if frame in chosen]
    return sorted([*own, *more], key=lambda number: time_s[number])


def _nearest(of: FloatArray, among: FloatArray) -> NDArray[np.int64]:
    """Return the index (N,) of the nearest of increasing numbers ``among`` (M,)."""
    return np.asarray(np.searchsorted((among[1:] + among[:-1]) / 2, of))
