"""Changes of when an actor is where on its trajectory, and spans of time in words: seconds of the log, frames beside
them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...core.geometry import FloatArray
from ..sampled.clock import Clock
from ..texts import Text
from .braking import Approach


def instant(time_s: float, clock: Clock) -> str:
    """Return a time of the log with its frame, as "1.20 s (frame 12)"."""
    return instant_of(time_s, float(clock.frame(np.array(time_s))))


def instant_of(time_s: float, frame: float) -> str:
    """Return the same of a time and its frame."""
    time, frame = round(time_s, 2) + 0.0, round(float(frame), 1) + 0.0  # no minus before a zero
    return Text("{time:.2f} s (frame {frame:g})", time=time, frame=frame)


def duration(seconds: float, clock: Clock) -> str:
    """Return a length of time with how many frames it is, as "0.50 s (5.0 frames)"."""
    return Text("{time:.2f} s ({frames:.1f} frames)", time=seconds, frames=seconds * clock.rate)


def span(start_s: float, end_s: float, clock: Clock) -> str:
    """Return from when to when something is, as "From 1.20 s (frame 12) to 2.00 s (frame 20)"."""
    return Text("From {start} to {end}", start=instant(start_s, clock), end=instant(end_s, clock))


def later_or_earlier(seconds: float, clock: Clock) -> str:
    """Return how much later or earlier something is, as "0.50 s (5.0 frames) later"."""
    return Text("{duration} later" if seconds >= 0 else "{duration} earlier", duration=duration(abs(seconds), clock))


def followed(way: Approach, start_s: float, clock: Clock) -> list[str]:
    """Return what following a curve comes to, in lines: how long it takes, from when to when, and where the
    log ends before."""
    end_s = float(clock.times_s[-1])
    lines: list[str] = [
        Text("{length:.1f} m take {duration}", length=way.length_m, duration=duration(way.duration_s, clock)),
        span(start_s, start_s + way.duration_s, clock),
    ]
    if way.top_m_s < way.speed_m_s:
        lines.append(Text("At {speed:.1f} m/s, to stop at the end", speed=way.top_m_s))
    if start_s + way.duration_s > end_s + 1e-6:
        left_m = way.length_m - float(way.lengths(np.array(max(end_s - start_s, 0.0))))
        lines += [
            Text("The log ends at {time}", time=instant(end_s, clock)),
            Text("{length:.1f} m before the curve's end", length=left_m),
        ]
    return lines


def followed_briefly(way: Approach, start_s: float, clock: Clock) -> str:
    """Return what following a curve comes to, short enough for the status bar."""
    ends_s = float(clock.times_s[-1])
    whole = Text("{length:.1f} m in {duration}", length=way.length_m, duration=duration(way.duration_s, clock))
    if start_s + way.duration_s <= ends_s + 1e-6:
        return whole
    return Text("{whole}; the log ends at {time:.2f} s", whole=whole, time=ends_s)


def stretched(first_s: float, last_s: float, speed: float, clock: Clock) -> list[str]:
    """Return what stretching the time between two comes to, in lines."""
    before, after = last_s - first_s, (last_s - first_s) / speed
    later = after - before
    return [
        span(first_s, last_s, clock),
        Text("{before} become {after}", before=duration(before, clock), after=duration(after, clock)),
        Text("Everything after that is {shift}", shift=later_or_earlier(later, clock)),
    ]


@dataclass(frozen=True)
class Retiming:
    """A change of times. ``mode`` is DELAY: all is later by ``seconds``; SPEED: from ``first_s`` on ``speed`` times as
    fast; STOP: it brakes from ``first_s`` on and stands for ``seconds``; STRETCH: from ``first_s`` to ``last_s``
    ``speed`` times as fast.

    Times are the log's, in seconds.
    """

    mode: str
    seconds: float
    speed: float
    first_s: float
    last_s: float

    def lines(self, clock: Clock) -> list[str]:
        """Return what the change comes to, in seconds and in frames."""
        if self.mode == "STRETCH":
            return stretched(self.first_s, self.last_s, self.speed, clock)
        if self.mode == "SPEED":
            return [
                Text("From {time} on", time=instant(self.first_s, clock)),
                Text("1 s becomes {duration}", duration=duration(1 / self.speed, clock)),
            ]
        if self.mode == "STOP":
            stands = Text("Stands for {duration}", duration=duration(abs(self.seconds), clock))
            return [Text("Brakes from {time} on", time=instant(self.first_s, clock)), stands]
        return [later_or_earlier(self.seconds, clock)]

    def summary(self, clock: Clock) -> str:
        """Return what the change comes to, in one line that the status bar has room for."""
        if self.mode == "STRETCH":
            whole = duration(self.last_s - self.first_s, clock)
            return Text("speed x{speed:.3g} for {duration}", speed=self.speed, duration=whole)
        if self.mode == "SPEED":
            return Text("speed x{speed:.3g} from {time} on", speed=self.speed, time=instant(self.first_s, clock))
        if self.mode == "STOP":
            return Text("stands for {duration}", duration=duration(abs(self.seconds), clock))
        return self.lines(clock)[0]

    def frames(self, clock: Clock) -> Callable[[FloatArray], FloatArray]:
        """Return the function that takes keys' frames to their new frames; STOP has none, as it adds keys."""
        change = self._times()
        return lambda frames: clock.frame(change(clock.time_s(frames)))

    def _times(self) -> Callable[[FloatArray], FloatArray]:
        if self.mode == "DELAY":
            return lambda old: old + self.seconds
        if self.mode == "SPEED":
            return lambda old: np.where(old > self.first_s, self.first_s + (old - self.first_s) / self.speed, old)
        first, last = self.first_s, self.last_s
        longer = (last - first) * (1 / self.speed - 1)
        return lambda old: old + longer * np.clip((old - first) / (last - first), 0, 1)
