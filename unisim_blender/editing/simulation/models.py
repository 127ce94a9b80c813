"""Models of actors as their documents say them: one JSON object as text, so that nothing is lost that no setting shows."""

from __future__ import annotations

import json
from dataclasses import MISSING, fields
from typing import Any

from ...core.errors import UnisimError
from ...core.scenario.schema import first_fault
from ...core.simulation.actors import models as _registers_them  # noqa: F401
from ...core.simulation.actors.model import MODELS, Model, Schema, model_from_dict, model_schema
from ..texts import translatable

TITLES = {
    "replay": (translatable("Replay"), translatable("As recorded; pedestrians stop before a vehicle in their way")),
    "idm": (
        translatable("Follow (IDM)"),
        translatable("Along the recorded path by the Intelligent Driver Model, behind what is in the way"),
    ),
    "auto": (
        translatable("Replay, Then Follow"),
        translatable("As recorded until the ego vehicle leaves its log or a conflict is foreseen, then Follow"),
    ),
    "lane": (
        translatable("Follow, On Past the End"),
        translatable("As Replay, Then Follow, and on along paths of other actors where its own path ends"),
    ),
    "cut_in": (
        translatable("Cut In"),
        translatable("As Replay, Then Follow, and changes into the path of the ego vehicle once it is ahead of it"),
    ),
    "attack": (
        translatable("Attack"),
        translatable("As Replay, Then Follow, and drives to where the ego vehicle will be once that is near (seeded)"),
    ),
    "scripted": (
        translatable("Scripted"),
        translatable("Along the recorded path by keys of speed and displacement, whatever is in the way"),
    ),
}
"""Name and description of each model for people; of others their own."""


def kinds() -> list[tuple[str, str, str]]:
    """Return the name of each registered model, and its title and description."""
    return [(name, *TITLES.get(name, (name, _about(kind)))) for name, kind in MODELS.items()]


def kind_of(text: str) -> str:
    """Return the name of the model that a document's text is of, `replay` for none."""
    found = _read(text).get("type")
    return found if isinstance(found, str) else "replay"


def with_kind(text: str, name: str) -> str:
    """Return the text with another model. What is stated of the one before stays where the new one has it and allows it."""
    known, kind = _read(text), MODELS[name]
    kept = {
        member: known[member]
        for member, schema in kind.members.items()
        if member in known and first_fault(known[member], schema) is None
    }
    needed = {one.name: _LEAST.get(one.name) for one in fields(kind) if one.default is MISSING}
    return json.dumps({"type": name, **needed, **kept})


def numbers_of(name: str) -> dict[str, Schema]:
    """Return the parameters of a model that are numbers, and their schemas; none for a model that is not registered."""
    members = MODELS[name].members if name in MODELS else {}
    return {member: schema for member, schema in members.items() if schema.get("type") in ("number", "integer")}


def value_of(text: str, member: str) -> float:
    """Return a parameter's value: the stated one, else the model's default; 0 where there is neither."""
    stated = _read(text).get(member)
    if isinstance(stated, int | float):
        return stated
    kind = MODELS.get(kind_of(text))
    default = next((one.default for one in fields(kind) if one.name == member), 0.0) if kind is not None else 0.0
    return float(default) if isinstance(default, int | float) else 0.0


def with_value(text: str, member: str, value: float) -> str:
    """Return the text with a parameter's value, the nearest that the model allows."""
    schema = numbers_of(kind_of(text)).get(member)
    if schema is None:
        return text
    return json.dumps({**(_read(text) or {"type": kind_of(text)}), member: nearest(value, schema)})


def nearest(value: float, schema: Schema) -> float:
    """Return the number nearest to a float32 value that a schema allows."""
    value = float(f"{value:.6g}")
    value = max(value, schema.get("minimum", value), schema.get("exclusiveMinimum", value - 1e-3) + 1e-3)
    value = min(value, schema.get("maximum", value))
    return round(value) if schema.get("type") == "integer" else value


def document_of(text: str, place: str) -> dict[str, Any] | None:
    """Return a model's document; None for "". Raises `ScenarioError` that names ``place`` for one that is not valid."""
    if not text:
        return None
    found = _read(text)
    model_from_dict(found, place)
    return found


def keys_text(text: str) -> str:
    """Return the keys of a `scripted` model in a line, "0 5, 2 - 1.5": seconds, speed, metres to the left."""
    keys = _read(text).get("keys")
    lines = []
    for key in keys if isinstance(keys, list) else []:
        known = [key.get(name) for name in ("time_s", "speed_m_s", "left_m")]
        while known and known[-1] is None:
            known.pop()
        lines.append(" ".join("-" if value is None else f"{value:g}" for value in known))
    return ", ".join(lines)


def with_keys(text: str, line: str) -> str:
    """Return the text with the keys of a line of `keys_text`, or as it is where that is none."""
    if line == keys_text(text):  # rounded numbers are not taken for new ones
        return text
    keys = []
    try:
        for part in line.split(","):
            values = [None if word == "-" else float(word) for word in part.split()]
            named = zip(("time_s", "speed_m_s", "left_m"), values, strict=False)
            keys.append({name: value for name, value in named if value is not None})
        document = {**_read(text), "keys": keys}
        model_from_dict(document)
    except (ValueError, UnisimError):
        return text
    return json.dumps(document)


_LEAST: dict[str, Any] = {"keys": [{"time_s": 0.0, "speed_m_s": 5.0}]}
"""Initial values of a model's members that have no default."""


def _read(text: str) -> dict[str, Any]:
    try:
        found = json.loads(text) if text else {}
    except (ValueError, RecursionError):
        found = {}
    return found if isinstance(found, dict) else {}


def _about(kind: type[Model]) -> str:
    return str(model_schema(kind)["description"]).rstrip(".")
