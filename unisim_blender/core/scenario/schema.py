"""The JSON Schema of scenario documents, assembled from the schemas beside each part's type, and checks of documents by
it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from ..errors import ScenarioError
from . import light, simulation, time_range, types, weather
from .checks import check_limits, place_in
from .edit import EDITS, Edit
from .json_schema import Schema, about_of, choice_of, members_of, ref, required_fields
from .motion import keys, placement
from .sensors import document as sensors

FORMAT, VERSION = "unisim-scenario", 1
DESCRIPTION = (
    "A recorded drive and what is changed of it. Metres, seconds, degrees; world: z up, re-centred on the first ego pose; "
    "boxes and the ego vehicle: x forward, y left, z up, position is a box's centre; times from the log's first frame. "
    "Paths are relative to the scenario's file."
)


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of scenario documents with all registered edits."""
    return _schema(tuple(EDITS.values()))


@cache
def _schema(kinds: tuple[type[Edit], ...]) -> dict[str, Any]:
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"UniSim scenario, version {VERSION}",
        "description": DESCRIPTION,
        "type": "object",
        "properties": {"format": {"const": FORMAT}, "version": {"const": VERSION}, **types.MEMBERS},
        "required": ["format", "version", "name", "log", "edits"],
        "additionalProperties": False,
        "$defs": {
            **types.DEFS,
            **placement.DEFS,
            **keys.DEFS,
            **time_range.DEFS,
            **sensors.DEFS,
            **simulation.DEFS,
            **weather.DEFS,
            **light.DEFS,
            "edit": choice_of({kind.type: ref(kind.type) for kind in kinds}),
            **{kind.type: edit_schema(kind) for kind in kinds},
        },
    }


def edit_schema(kind: type[Edit]) -> Schema:
    """Return the JSON Schema of one edit: its members, of which those without a default are required.

    A member with a former name may be given by either of the two names, but not by both.
    """
    required, renamed = required_fields(kind), set(kind.former_names.values())
    former = {
        name: {**kind.members[current], "deprecated": True, "description": f"Former name of `{current}`, read as that."}
        for name, current in kind.former_names.items()
    }
    either = [
        {
            "if": {"required": [name]},
            "then": {"not": {"required": [current]}},
            **({"else": {"required": [current]}} if current in required else {}),
        }
        for name, current in kind.former_names.items()
    ]
    schema = members_of(
        {"type": {"const": kind.type}, **kind.members, **former},
        ["type", *(name for name in required if name not in renamed)],
        about_of(kind),
    )
    return {**schema, "allOf": either} if either else schema


def check_document(document: Any, path: Path) -> None:
    """Raise `ScenarioError` for the first fault, in the file's order, that the schema finds in a JSON value."""
    check_by_schema(document, scenario_schema(), path)


def check_by_schema(document: Any, schema: dict[str, Any], path: Path) -> None:
    """Raise `ScenarioError` for the first fault that a schema, with ``format`` and ``version``, finds in a
    file's JSON value."""
    if isinstance(document, dict) and document.get("format") == schema["properties"]["format"]["const"]:
        version = document.get("version")
        if isinstance(version, int) and version > 1:
            raise ScenarioError(f"{path}: has version {version}, newer than the 1 that this program reads")
    check_limits(document, path)
    fault = first_fault(document, schema)
    if fault is not None:
        raise ScenarioError(f"{place_in(path, fault[0])}: {fault[1]}")


def first_fault(value: Any, schema: Mapping[str, Any]) -> tuple[tuple[str | int, ...], str] | None:
    """Return the steps to the first fault, in a document's order, that a schema finds in a JSON value, and what it is;
    None where it finds none. Numbers that are not finite are none."""
    faults = _validator()(schema).iter_errors(value)
    first = min(faults, key=lambda fault: [str(step).zfill(8) for step in fault.absolute_path], default=None)
    if first is None:
        return None
    message = first.message if len(first.message) <= 200 else f"{first.message[:120]} … {first.message[-60:]}"
    return tuple(first.absolute_path), message


@cache
def _validator() -> Any:
    from jsonschema import (
        Draft202012Validator,
        validators,
    )  # here: scenarios can be written where only numpy is installed

    known = Draft202012Validator.TYPE_CHECKER

    def is_number(checker: Any, value: Any) -> bool:
        return known.is_type(value, "number") and math.isfinite(value)

    return validators.extend(Draft202012Validator, type_checker=known.redefine("number", is_number))
