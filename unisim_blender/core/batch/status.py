"""How far a batch is, by what its store holds: it may run, or have been ended."""

from __future__ import annotations

import json
from typing import Any

from ..errors import OutputError
from .manifest import MANIFEST_NAME
from .records import RECORDS, read_failures
from .run import PLAN_NAME
from .store import Store


def batch_status(store: Store) -> dict[str, Any]:
    """Return the counts of a batch as a JSON object: captures, units, those finished, those that failed and why, and whether
    its manifest is written. Raises `OutputError` where the store holds no batch."""
    data = store.read(PLAN_NAME)
    try:
        plan = {} if data is None else json.loads(data)
        units, captures, variants = len(plan["units"]), plan["captures"], len(plan["variants"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise OutputError(f"{store.url}: holds no batch") from error
    finished = len(store.sizes(RECORDS))
    failures = read_failures(store)
    return {
        "variants": variants,
        "captures": captures,
        "units": units,
        "finished": finished,
        "failures": [{name: one.get(name) for name in ("unit", "variant", "reason", "command")} for one in failures],
        "manifest": store.read(MANIFEST_NAME) is not None,
    }
