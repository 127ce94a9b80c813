"""How long the units of a batch that are left will take, by when others were finished."""

from __future__ import annotations

from collections.abc import Sequence

NEWEST = 50
"""Of so many units the pace is taken: how fast it was long ago tells little."""


def seconds_left(times_s: Sequence[float], left: int, now_s: float) -> float | None:
    """Return how long ``left`` units will take, by the times at which others were finished; the first may be that of the start.

    None where too few are known to say.
    """
    if left == 0:
        return 0.0
    times = sorted(times_s)[-NEWEST:]
    if len(times) < 2:
        return None
    each_s = (times[-1] - times[0]) / (len(times) - 1)
    return each_s * left - min(max(now_s - times[-1], 0.0), each_s)


def clock_text(seconds: float | None) -> str:
    """Return a time as 1:02:03 or 2:03; a dash where it is not known."""
    if seconds is None:
        return "–"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
