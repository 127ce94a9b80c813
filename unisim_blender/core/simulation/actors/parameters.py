"""Parameters of a model of actors as a document has them: JSON Schema fragments, and their check."""

from __future__ import annotations

from typing import Any

from ...errors import ScenarioError
from ...scenario.fragments import Schema as Schema
from ...scenario.limits import steps_in_words
from ...scenario.schema import first_fault

SPEED: Schema = {"type": "number", "minimum": 0, "maximum": 100}
SPEED_DIFFERENCE: Schema = {"type": "number", "minimum": -100, "maximum": 100}
ACCELERATION: Schema = {"type": "number", "exclusiveMinimum": 0, "maximum": 50}
DURATION: Schema = {"type": "number", "exclusiveMinimum": 0, "maximum": 600}
LENGTH: Schema = {"type": "number", "minimum": 0, "maximum": 1000}
COUNT: Schema = {"type": "integer", "minimum": 1, "maximum": 1000}


def check_parameters(value: Any, schema: Schema, place: str) -> None:
    """Raise `ScenarioError` for the first fault of a JSON value by a schema: the place below ``place``, and a sentence."""
    fault = first_fault(value, schema)
    if fault is not None:
        raise ScenarioError(f"{place}{steps_in_words(fault[0])}: {fault[1]}")
