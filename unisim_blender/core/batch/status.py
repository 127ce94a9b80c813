"""Progress of a batch, read from its store; the batch may be running or ended."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from typing import Any

from ..errors import OutputError
from .manifest import MANIFEST_NAME
from .plan import PLAN_NAME
from .records import RECORDS, Store, read_failures

PACE_UNITS = 50
"""Number of latest units from which the pace is estimated."""


def seconds_left(times_s: Sequence[float], left: int, now_s: float) -> float | None:
    """Return how long ``left`` units will take, by the times at which others were finished; the first may be that of the start.

    None where too few are known to say.
    """
    if left == 0:
        return 0.0
    times = sorted(times_s)[-PACE_UNITS:]
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


def batch_status(store: Store) -> dict[str, Any]:
    """Return the counts of a batch as a JSON object: captures, units, those finished, those that failed and why, whether its
    manifest is written, and how long what is left will take at the pace of the newest units, None where that is not known.

    Raises `OutputError` where the store holds no batch.
    """
    data = store.read(PLAN_NAME)
    try:
        plan = {} if data is None else json.loads(data)
        units, captures, variants = len(plan["units"]), plan["captures"], len(plan["variants"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise OutputError(f"{store.url}: holds no batch") from error
    times = sorted(store.times(RECORDS).values())
    failures, now = read_failures(store), time.time()
    finished = len(store.sizes(RECORDS))
    return {
        "variants": variants,
        "captures": captures,
        "units": units,
        "finished": finished,
        "seconds_left": seconds_left(times, units - finished - len(failures), now),
        "seconds_since_last": max(0.0, now - times[-1]) if times else None,
        "failures": [
            {name: failure.get(name) for name in ("unit", "variant", "reason", "command")} for failure in failures
        ],
        "manifest": store.read(MANIFEST_NAME) is not None,
    }
