"""The member `simulation` of a scenario as one JSON object in text, the models of its actors as one text each, and the
settings that they are shown and changed by.

What no setting shows stays in the texts: the vehicle, sensors' rates. A member of ``jitter`` is named
"jitter.ego_along_m".
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

from ...core.errors import UnisimError
from ...core.scenario import scenario_from_json, scenario_to_json
from ...core.scenario.edit import Edit
from ...core.scenario.json_schema import Schema
from ...core.scenario.schema import first_fault
from ...core.scenario.simulation import OTHER_ACTORS, SimulationSpec
from ...core.scenario.times import recording_us
from ...core.scenario.types import Outputs, Scenario
from ...core.simulation.actors import models as _registers_them  # noqa: F401
from ...core.simulation.actors.model import MODELS, Model, model_from_dict, model_schema
from ...core.world.captures import US_PER_SECOND
from ...core.world.drive import Drive
from ..texts import translatable

MODEL_TITLES = {
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
    return [(name, *MODEL_TITLES.get(name, (name, _about(kind)))) for name, kind in MODELS.items()]


def kind_of(text: str) -> str:
    """Return the name of the model that a document's text is of, `replay` for none."""
    kind = _read(text).get("type")
    return kind if isinstance(kind, str) else "replay"


def with_kind(text: str, name: str) -> str:
    """Return the text with another model. What is stated of the one before stays where the new one has it and allows
    it."""
    known, kind = _read(text), MODELS[name]
    allowed = {
        member: known[member]
        for member, schema in kind.members.items()
        if member in known and first_fault(known[member], schema) is None
    }
    needed = {field.name: _LEAST.get(field.name) for field in fields(kind) if field.default is MISSING}
    return json.dumps({"type": name, **needed, **allowed})


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
    default = next((field.default for field in fields(kind) if field.name == member), 0.0) if kind is not None else 0.0
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
    document = _read(text)
    model_from_dict(document, place)
    return document


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


def _about(kind: type[Model]) -> str:
    return str(model_schema(kind)["description"]).rstrip(".")


STEP_S = 0.1
JITTER = "jitter."
SETTINGS: Mapping[str, tuple[float, float, float]] = {
    "start_s": (0.0, -1e6, 1e6),
    "duration_s": (5.0, 0.01, 1e6),
    "step_s": (STEP_S, 0.01, 10.0),
    "delay_s": (0.0, 0.0, 10.0),
    "seed": (0, 0, 2**31 - 1),
    "jitter.ego_along_m": (0.0, 0.0, 100.0),
    "jitter.ego_aside_m": (0.0, 0.0, 10.0),
    "jitter.ego_yaw_deg": (0.0, 0.0, 180.0),
    "jitter.ego_speed_m_s": (0.0, 0.0, 50.0),
    "jitter.actors_s": (0.0, 0.0, 100.0),
}
"""Values that settings show where the text states nothing, and the settings' limits."""
_PLACE = Path("the simulation of the scene")


def states(text: str, member: str) -> bool:
    """Return whether a simulation's text has a member."""
    return member in _read(text)


def number_of(text: str, member: str) -> float:
    """Return a member's number as a setting shows it: the stated one within the setting's limits, else its default."""
    value = _stated(_read(text), member)
    default, low, high = SETTINGS[member]
    return min(max(value if isinstance(value, int | float) else default, low), high)


def stated_number(text: str, member: str) -> float:
    """Return a member's number as it is stated, else its default."""
    value = _read(text).get(member)
    return value if isinstance(value, int | float) else SETTINGS[member][0]


def from_time(text: str, start_s: float, end_s: float) -> str:
    """Return the text with a start, and the end where it limits the duration."""
    document = {**_read(text), "start_s": round(start_s, 6)}
    if "duration_s" in document:
        document["duration_s"] = round(end_s - start_s, 6)
    return _written(document)


def with_number(text: str, member: str, value: float) -> str:
    """Return the text with a member's number. A value that is shown already changes nothing; a delay is a multiple of
    the step, the one before where that changes."""
    if abs(value - number_of(text, member)) <= 1e-6 * max(abs(value), 1e-3):
        return text
    _, low, high = SETTINGS[member]
    value = min(max(float(f"{value:.6g}"), low), high)
    if member.startswith(JITTER):
        return _with_jitter(_read(text), member.removeprefix(JITTER), value)
    document = {**_read(text), member: int(value) if member == "seed" else value}
    if member in ("step_s", "delay_s") and document.get("delay_s"):
        step = document.get("step_s", STEP_S)
        document["delay_s"] = round(round(document["delay_s"] / step) * step, 9)
    return _written(document)


def with_default(text: str, member: str) -> str:
    """Return the text with a member's default stated."""
    return _written({**_read(text), member: SETTINGS[member][0]})


def without(text: str, member: str) -> str:
    """Return the text without a member."""
    return _written({name: value for name, value in _read(text).items() if name != member})


def hidden_members(text: str) -> list[str]:
    """Return what a text states that no setting shows, by the members' names."""
    return [name for name in _read(text) if name not in (*SETTINGS, "actors", "jitter")]


def vehicle_parameters(text: str) -> dict[str, Any]:
    """Return the parameters of the vehicle that a text states."""
    parameters = _read(text).get("vehicle")
    return parameters if isinstance(parameters, dict) else {}


def simulation_text(spec: SimulationSpec | None) -> str:
    """Return a simulation as text; "" for none."""
    return "" if spec is None else _written(_as_json(spec))


def actors_texts(spec: SimulationSpec | None) -> dict[str, str]:
    """Return the actors' models of a simulation as texts, by id."""
    return {uid: json.dumps(document) for uid, document in ((spec.actors if spec else None) or {}).items()}


def simulation_of(text: str, actors: Mapping[str, str], known: Iterable[str]) -> SimulationSpec | None:
    """Return the simulation of a text, with ``actors``' models as texts by id, of which only those of ``known`` ids and
    the others' count; None where nothing is stated. Raises `ScenarioError`."""
    document = _read(text)
    ids = {*known, OTHER_ACTORS}
    models = {
        **document.pop("actors", {}),
        **{
            uid: document_of(model, f"simulation.actors.{uid}") for uid, model in actors.items() if model and uid in ids
        },
    }
    if models:
        document["actors"] = models
    if not document:
        return None
    whole = {**scenario_to_json(Scenario(name="kept", log="log")), "simulation": document}
    return scenario_from_json(whole, _PLACE).simulation


def ids_of(edits: Iterable[Edit], recorded: Iterable[str]) -> set[str]:
    """Return the ids of the actors that there are with a scenario's edits, of those recorded."""
    ids = set(recorded)
    for edit in edits:
        ids = {uid for uid in ids if not edit.removes(uid)}
        new = getattr(edit, "id", None)
        if isinstance(new, str):
            ids.add(new)
    return ids


def _as_json(spec: SimulationSpec) -> dict[str, Any]:
    document = scenario_to_json(Scenario(name="kept", log="log", simulation=spec)).get("simulation", {})
    assert isinstance(document, dict)
    return document


def _stated(document: Mapping[str, Any], member: str) -> Any:
    if not member.startswith(JITTER):
        return document.get(member)
    jitter = document.get("jitter")
    return jitter.get(member.removeprefix(JITTER)) if isinstance(jitter, dict) else None


def _with_jitter(document: dict[str, Any], name: str, value: float) -> str:
    known = document.get("jitter")
    jitter = {**(known if isinstance(known, dict) else {}), name: value}
    document["jitter"] = {name: most for name, most in jitter.items() if most}
    return _written(
        document if document["jitter"] else {name: member for name, member in document.items() if name != "jitter"}
    )


def _written(document: dict[str, Any]) -> str:
    return json.dumps(document) if document else ""


def _read(text: str) -> dict[str, Any]:
    try:
        document = json.loads(text) if text else {}
    except (ValueError, RecursionError):
        document = {}
    return dict(document) if isinstance(document, dict) else {}


def as_simulated(read: Scenario) -> Scenario:
    """Return a scenario as it is simulated: not at the frames or times that a sequence of it has, with the passes that
    drivers and scores need."""
    outputs = replace(read.outputs or Outputs(), passes=None)
    return replace(read, frames=None, times=None, outputs=outputs)


def count_steps(scenario: Scenario, recorded: Drive) -> int:
    """Return how many steps a scenario's simulation has, at least one. Whether it fits into the drive `unisim drive`
    says."""
    first_us, last_us = recording_us(recorded)
    spec = scenario.simulation
    start = first_us / US_PER_SECOND if spec is None or spec.start_s is None else spec.start_s
    length = last_us / US_PER_SECOND - start if spec is None or spec.duration_s is None else spec.duration_s
    step = STEP_S if spec is None or spec.step_s is None else spec.step_s
    return max(1, math.ceil(round(length / step, 6)))
