"""Spans of time as people read them: seconds of the log, frames beside them. numpy alone."""

from __future__ import annotations

import numpy as np

from ..sampled.clock import Clock


def instant(time_s: float, clock: Clock) -> str:
    """Return a time of the log with its frame, as "1.20 s (frame 12.0)"."""
    frame = round(float(clock.frame(np.array(time_s))), 1)
    return f"{round(time_s, 2) + 0.0:.2f} s (frame {frame + 0.0:.1f})"  # no minus before a zero


def duration(seconds: float, clock: Clock) -> str:
    """Return a length of time with how many frames it is, as "0.50 s (5.0 frames)"."""
    return f"{seconds:.2f} s ({seconds * clock.rate:.1f} frames)"


def followed(length_m: float, speed_m_s: float, start_s: float, clock: Clock) -> list[str]:
    """Return what following a curve comes to, in lines: how long it takes, from when to when, and where the
    log ends before."""
    takes = length_m / speed_m_s
    lines = [
        f"{length_m:.1f} m take {duration(takes, clock)}",
        f"From {instant(start_s, clock)} to {instant(start_s + takes, clock)}",
    ]
    end_s = float(clock.times_s[-1])
    if start_s + takes > end_s + 1e-6:
        left_m = length_m - max(end_s - start_s, 0.0) * speed_m_s
        lines += [f"The log ends at {instant(end_s, clock)}", f"{left_m:.1f} m before the curve's end"]
    return lines


def followed_briefly(length_m: float, speed_m_s: float, start_s: float, clock: Clock) -> str:
    """Return what following a curve comes to, short enough for the status bar."""
    takes, ends_s = length_m / speed_m_s, float(clock.times_s[-1])
    whole = f"{length_m:.1f} m in {duration(takes, clock)}"
    return f"{whole}; the log ends at {ends_s:.2f} s" if start_s + takes > ends_s + 1e-6 else whole


def stretched(first_s: float, last_s: float, speed: float, clock: Clock) -> list[str]:
    """Return what stretching the time between two comes to, in lines."""
    before, after = last_s - first_s, (last_s - first_s) / speed
    later = after - before
    return [
        f"From {instant(first_s, clock)} to {instant(last_s, clock)}",
        f"{duration(before, clock)} become {duration(after, clock)}",
        f"What comes after is {duration(abs(later), clock)} {'later' if later >= 0 else 'earlier'}",
    ]
