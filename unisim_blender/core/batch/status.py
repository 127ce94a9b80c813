"""How far a batch is, by what its store holds: it may run, or have been ended."""

from __future__ import annotations

import json
import time
from typing import Any

from ..errors import OutputError
from .manifest import MANIFEST_NAME
from .pace import seconds_left
from .plan import PLAN_NAME
from .records import RECORDS, read_failures
from .store import Store


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
        "failures": [{name: one.get(name) for name in ("unit", "variant", "reason", "command")} for one in failures],
        "manifest": store.read(MANIFEST_NAME) is not None,
    }
