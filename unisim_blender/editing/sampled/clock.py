"""Frames of a Blender scene, seconds and captures: frame n of the scene is frame n of the log; and recorded actors at
them.

Import, export, F12, the viewport and Render Sequence all go by a `Clock`: which capture of a sensor a frame is, and
back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.geometry import BoolArray, FloatArray
from ...core.scenario.types import FrameRange
from ...core.world.captures import Capture, microseconds
from ...core.world.drive import Actor, Camera, Drive, Lidar


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

    def index(self, frame: float) -> int:
        """The index of the frame that counts at ``frame``, whole or not: each counts until the next."""
        return int(np.clip(np.searchsorted(self.frames, frame + 1e-6, side="right") - 1, 0, len(self.frames) - 1))

    def around(self, frame: float) -> Clock:
        """The clock of the frames next to ``frame``: the two or three that a frame's sensors may look at."""
        first = int(np.searchsorted(self.frames, frame, side="left")) - 1
        last = int(np.searchsorted(self.frames, frame, side="right"))
        first, last = max(0, min(first, len(self.frames) - 2)), min(max(last, 1), len(self.frames) - 1)
        return Clock(self.frames[first : last + 1], self.times_s[first : last + 1])

    def of_sensor(self, sensor: Camera | Lidar) -> Clock:
        """The same frames at a sensor's own timestamps; where it lacks a frame, the frame's time and the
        sensor's usual delay."""
        own = sensor.time_s
        delays = [time_s - float(self.time_s(np.array(float(frame)))) for frame, time_s in own.items()]
        delay = np.median(delays) if delays else 0.0
        times = [
            own[int(frame)] if frame.is_integer() and int(frame) in own else time_s + delay
            for frame, time_s in zip(self.frames.tolist(), self.times_s.tolist(), strict=True)
        ]
        return Clock(self.frames, np.array(times))

    def capture(self, sensor: Camera | Lidar, frame: float) -> Capture:
        """A sensor's capture that a frame, whole or not, shows: that of the log's frame where the sensor has one, else
        the one at the time between its timestamps."""
        if float(frame).is_integer() and int(frame) in sensor.time_s:
            return Capture.of_frame(sensor, int(frame))
        return Capture.at(sensor, microseconds(float(self.of_sensor(sensor).time_s(np.array(frame)))))

    def frame_of(self, sensor: Camera | Lidar, capture: Capture) -> float:
        """The frame, whole or not, that shows a sensor's capture."""
        if capture.frame is not None:
            return float(capture.frame)
        return float(self.of_sensor(sensor).frame(np.array(capture.time_s(sensor))))

    def frame_range(self, first: int, last: int, step: int) -> FrameRange | None:
        """The log's frames that a Blender scene's frame range and step name; None for all of them."""
        everything = first <= self.frames[0] and last >= self.frames[-1] and step == 1
        return None if everything else FrameRange(first, last + 1, step)

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


def recorded_poses(actor: Actor, clock: Clock) -> FloatArray:
    """Poses (N, 4, 4) of an actor as the import has them."""
    trajectory = actor.world_from_actor
    return trajectory.at(clock.times_s if actor.is_moving else np.full(len(clock.times_s), trajectory.times_s[0]))


def recorded_there(actor: Actor, drive: Drive, clock: Clock) -> BoolArray:
    """Whether an actor is there (N,) as the import has it."""
    start, end = drive.window(actor)
    return np.asarray((clock.times_s >= start) & (clock.times_s <= end))
