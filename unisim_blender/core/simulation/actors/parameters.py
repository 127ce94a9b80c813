"""Parameters of a model of actors as a document has them: JSON Schema fragments, and checks that say what is wrong in one
sentence.

The checks cover what these fragments use. They need no package, so parameters can be made where only numpy is installed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

Schema = Mapping[str, Any]
"""A JSON Schema, draft 2020-12, as Python values."""

SPEED: Schema = {"type": "number", "minimum": 0, "maximum": 100}
SPEED_DIFFERENCE: Schema = {"type": "number", "minimum": -100, "maximum": 100}
ACCELERATION: Schema = {"type": "number", "exclusiveMinimum": 0, "maximum": 50}
DURATION: Schema = {"type": "number", "exclusiveMinimum": 0, "maximum": 600}
LENGTH: Schema = {"type": "number", "minimum": 0, "maximum": 1000}
COUNT: Schema = {"type": "integer", "minimum": 1, "maximum": 1000}


def first_fault(value: Any, schema: Schema) -> tuple[str, str] | None:
    """Return where below a value, and in what, it does not follow a schema: ("[2].time_s", "must be ..."); None where it does."""
    kind = schema.get("type")
    if kind is None:
        return None
    if kind == "array":
        return _fault_of_array(value, schema)
    if kind == "object":
        return _fault_of_object(value, schema)
    if kind == "boolean":
        return None if isinstance(value, bool) else ("", f"must be true or false, not {value!r}")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "", f"must be a finite number, not {value!r}"
    if kind == "integer" and value != int(value):
        return "", f"must be a whole number, not {value!r}"
    least, above, most = schema.get("minimum"), schema.get("exclusiveMinimum"), schema.get("maximum")
    if least is not None and value < least:
        return "", f"must be {least:g} or more, not {value:g}"
    if above is not None and value <= above:
        return "", f"must be above {above:g}, not {value:g}"
    if most is not None and value > most:
        return "", f"must be {most:g} or less, not {value:g}"
    return None


def _fault_of_array(value: Any, schema: Schema) -> tuple[str, str] | None:
    if not isinstance(value, list | tuple):
        return "", f"must be a list, not {value!r}"
    if not schema["minItems"] <= len(value) <= schema["maxItems"]:
        return "", f"must have {schema['minItems']} to {schema['maxItems']} items, not {len(value)}"
    for index, item in enumerate(value):
        fault = first_fault(item, schema["items"])
        if fault is not None:
            return f"[{index}]{fault[0]}", fault[1]
    return None


def _fault_of_object(value: Any, schema: Schema) -> tuple[str, str] | None:
    if not isinstance(value, dict):
        return "", f"must be an object, not {value!r}"
    known = schema["properties"]
    for name in schema.get("required", ()):
        if name not in value:
            return "", f"needs {name}"
    for name, member in value.items():
        if name not in known:
            return "", f"has no member {name!r} (there are {', '.join(known)})"
        fault = first_fault(member, known[name])
        if fault is not None:
            return f".{name}{fault[0]}", fault[1]
    return None
