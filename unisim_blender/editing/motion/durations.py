"""Spans of time as people read them: seconds of the log, frames beside them. numpy alone."""

from __future__ import annotations

import numpy as np

from ..sampled.clock import Clock
from ..texts import Text


def instant(time_s: float, clock: Clock) -> str:
    """Return a time of the log with its frame, as "1.20 s (frame 12.0)"."""
    frame = round(float(clock.frame(np.array(time_s))), 1)
    return Text(
        "{time:.2f} s (frame {frame:.1f})", time=round(time_s, 2) + 0.0, frame=frame + 0.0
    )  # no minus before a zero


def duration(seconds: float, clock: Clock) -> str:
    """Return a length of time with how many frames it is, as "0.50 s (5.0 frames)"."""
    return Text("{time:.2f} s ({frames:.1f} frames)", time=seconds, frames=seconds * clock.rate)


def span(start_s: float, end_s: float, clock: Clock) -> str:
    """Return from when to when something is, as "From 1.20 s (frame 12.0) to 2.00 s (frame 20.0)"."""
    return Text("From {start} to {end}", start=instant(start_s, clock), end=instant(end_s, clock))


def later_or_earlier(seconds: float, clock: Clock) -> str:
    """Return how much later or earlier something is, as "0.50 s (5.0 frames) later"."""
    return Text("{duration} later" if seconds >= 0 else "{duration} earlier", duration=duration(abs(seconds), clock))


def followed(length_m: float, speed_m_s: float, start_s: float, clock: Clock) -> list[str]:
    """Return what following a curve comes to, in lines: how long it takes, from when to when, and where the
    log ends before."""
    takes = length_m / speed_m_s
    lines: list[str] = [
        Text("{length:.1f} m take {duration}", length=length_m, duration=duration(takes, clock)),
        span(start_s, start_s + takes, clock),
    ]
    end_s = float(clock.times_s[-1])
    if start_s + takes > end_s + 1e-6:
        left_m = length_m - max(end_s - start_s, 0.0) * speed_m_s
        lines += [
            Text("The log ends at {time}", time=instant(end_s, clock)),
            Text("{length:.1f} m before the curve's end", length=left_m),
        ]
    return lines


def followed_briefly(length_m: float, speed_m_s: float, start_s: float, clock: Clock) -> str:
    """Return what following a curve comes to, short enough for the status bar."""
    takes, ends_s = length_m / speed_m_s, float(clock.times_s[-1])
    whole = Text("{length:.1f} m in {duration}", length=length_m, duration=duration(takes, clock))
    if start_s + takes <= ends_s + 1e-6:
        return whole
    return Text("{whole}; the log ends at {time:.2f} s", whole=whole, time=ends_s)


def stretched(first_s: float, last_s: float, speed: float, clock: Clock) -> list[str]:
    """Return what stretching the time between two comes to, in lines."""
    before, after = last_s - first_s, (last_s - first_s) / speed
    later = after - before
    return [
        span(first_s, last_s, clock),
        Text("{before} become {after}", before=duration(before, clock), after=duration(after, clock)),
        Text("What comes after is {shift}", shift=later_or_earlier(later, clock)),
    ]
