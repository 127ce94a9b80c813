"""Frames and seconds: frame n of the Blender scene is frame n of the log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.geometry import FloatArray
from ...core.world.drive import Drive


@dataclass(frozen=True)
class Clock:
    """Frames (N,) as numbers, whole or not, and their times (N,) in seconds, both rising. At least two."""

    frames: FloatArray
    times_s: FloatArray

    @staticmethod
    def of(drive: Drive) -> Clock:
        """The clock of a drive's frames."""
        frames = sorted(drive.time_s)
        times = [drive.time_s[frame] for frame in frames]
        if len(frames) == 1:  # a rate has to come from somewhere
            frames, times = [frames[0], frames[0] + 1], [times[0], times[0] + 0.1]
        return Clock(np.array(frames, float), np.array(times))

    @property
    def rate(self) -> float:
        """Frames a second."""
        return float((self.frames[-1] - self.frames[0]) / (self.times_s[-1] - self.times_s[0]))

    def around(self, frame: float) -> Clock:
        """The clock of the frames next to ``frame``: the two or three that a frame's sensors may look at."""
        first = int(np.searchsorted(self.frames, frame, side="left")) - 1
        last = int(np.searchsorted(self.frames, frame, side="right"))
        first, last = max(0, min(first, len(self.frames) - 2)), min(max(last, 1), len(self.frames) - 1)
        return Clock(self.frames[first : last + 1], self.times_s[first : last + 1])

    def frame(self, time_s: FloatArray) -> FloatArray:
        """Frames (...) at times (...); beyond the ends at the mean rate."""
        return _through(np.asarray(time_s, float), self.times_s, self.frames)

    def time_s(self, frame: FloatArray) -> FloatArray:
        """Times (...) of frames (...)."""
        return _through(np.asarray(frame, float), self.frames, self.times_s)


def _through(x: FloatArray, xs: FloatArray, ys: FloatArray) -> FloatArray:
    slope = (ys[-1] - ys[0]) / (xs[-1] - xs[0])
    inside = np.interp(x, xs, ys)
    beyond = np.where(x < xs[0], x - xs[0], np.where(x > xs[-1], x - xs[-1], 0.0))
    return np.asarray(inside + slope * beyond)
