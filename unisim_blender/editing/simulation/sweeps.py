"""Sweeps: which fields of a scenario parameters may fill, and the documents that `unisim batch` takes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.errors import UnisimError
from ...core.files import write_file
from ...core.json_file import json_bytes
from ...core.scenario.simulation import OTHER_ACTORS
from ...core.scenario.types import Scenario
from ..reading.scenario import write_scenario
from ..texts import Text, translatable
from .stated import numbers_of, value_of

MEMBERS = ("edits", "simulation", "sensors")
"""Members of a scenario that parameters may lie in."""
_LEFT_OUT = (
    *("type", "id", "mesh", "scene", "trajectory", "map", "box", "label", "outside", "quaternion_wxyz", "leader"),
    *("along", "path"),
)
"""Members that are no choice of a sweep: nobody varies one key of a trajectory, or one number of a rotation."""
WORDS: dict[str, tuple[str, float]] = {
    "offset_m/0": (translatable("forward"), 5.0),
    "offset_m/1": (translatable("left"), 1.0),
    "offset_m/2": (translatable("up"), 0.2),
    "ahead_m": (translatable("ahead along the path"), 5.0),
    "later_s": (translatable("later"), 1.0),
    "time_offset_s": (translatable("later"), 1.0),
    "offset_s": (translatable("later"), 1.0),
    "position/0": (translatable("place along x"), 5.0),
    "position/1": (translatable("place along y"), 1.0),
    "position/2": (translatable("place along z"), 0.2),
    "yaw_deg": (translatable("heading"), 10.0),
    "turn_deg": (translatable("turned left"), 10.0),
    "start_m": (translatable("from"), 5.0),
    "end_m": (translatable("to"), 5.0),
    "end_left_m": (translatable("left at the end"), 1.0),
    "spacing_m": (translatable("spacing"), 0.0),
    "count": (translatable("number"), 2.0),
    "shift_left_m": (translatable("left"), 1.0),
    "speed": (translatable("speed, as a factor"), 0.0),
    "speed_m_s": (translatable("speed"), 0.0),
    "stands_s": (translatable("stands for"), 1.0),
    "deceleration_m_s2": (translatable("deceleration"), 0.0),
    "at_s": (translatable("time"), 1.0),
    "left_m": (translatable("left"), 1.0),
    "edits/gap_s": (translatable("gap"), 0.0),
    "edits/gap_m": (translatable("gap"), 0.0),
    "from_m": (translatable("distance aside"), 2.0),
    "lane_m": (translatable("distance aside"), 0.5),
    "side": (translatable("side"), 0.0),
    "headway_s": (translatable("gap in time"), 0.0),
    "gap_m": (translatable("gap at rest"), 0.0),
    "acceleration_m_s2": (translatable("acceleration"), 0.0),
    "braking_m_s2": (translatable("braking"), 0.0),
    "delay_s": (translatable("delay"), 0.0),
    "seed": (translatable("seed"), 0.0),
    "appearance": (translatable("appearance"), 0.0),
    "actor": (translatable("appearance"), 0.0),
}
"""What members are called, and how far to either side of the value a range reaches at first; 0: half of the value."""
UNITS = {"m": "m", "s": "s", "deg": "°", "rad": "rad", "m_s": "m/s", "m_s2": "m/s²", "hz": "Hz"}
"""Units by how the names of members end."""


@dataclass(frozen=True)
class ScenarioField:
    """A number or a text of a scenario, at a JSON pointer. ``label`` says whose and which, with its unit; ``reach`` is
    how far to either side of the value a range goes at first."""

    pointer: str
    label: str
    value: float | str
    reach: float = 0.0

    @property
    def range(self) -> tuple[float, float]:
        """First and last value of a range at first; what is at least 0 stays so."""
        assert not isinstance(self.value, str)
        reach = self.reach or abs(self.value) / 2 or 1.0
        low = self.value - reach
        return round(low if self.reach or self.value < 0 else max(low, 0.0), 3), round(self.value + reach, 3)


@dataclass(frozen=True)
class Parameter:
    """A parameter: ``values``, or ``count`` numbers from ``start`` to ``stop`` where there are none."""

    name: str
    at: str
    values: tuple[Any, ...] = ()
    start: float = 0.0
    stop: float = 0.0
    count: int = 1

    def document(self) -> dict[str, Any]:
        """Return the parameter as a sweep has it."""
        if self.values:
            return {"at": self.at, "values": list(self.values)}
        return {"at": self.at, "range": {"start": self.start, "stop": self.stop, "count": self.count}}

    @property
    def variants(self) -> int:
        """Number of values."""
        return len(self.values) or self.count


def fields_of(document: dict[str, Any], names: Mapping[str, str]) -> list[ScenarioField]:
    """Return the fields of a scenario, as a JSON value, that a parameter may fill. ``names`` are those of actors by
    id."""
    document = _with_defaults(document)
    fields = []
    for member in MEMBERS:
        for path, value in _leaves(document.get(member), (member,)):
            if path[0] == "edits" and path[2] == "actor" and document["edits"][path[1]]["type"] not in _ADDS:
                continue  # whose edit it is
            pointer = "".join(f"/{_escaped(part)}" for part in path)
            words, reach = _words(path)
            who = _owner(document, path)
            label = Text("{who}: {what}", who=names.get(who, who) if isinstance(who, str) else who, what=words)
            fields.append(ScenarioField(pointer, label, value, reach))
    return fields


_ADDS = ("insert", "duplicate")
"""Edits whose actor is the appearance of a new one."""


def _with_defaults(document: dict[str, Any]) -> dict[str, Any]:
    """Return a scenario with the shifts of moves and the parameters of models that it leaves to their defaults."""
    edits = [
        {"ahead_m": 0.0, "later_s": 0.0, **edit} if edit["type"] == "move" and "offset_m" in edit else edit
        for edit in document.get("edits", [])
    ]
    simulation = document.get("simulation", {})
    actors = {
        uid: {**{name: value_of(json.dumps(model), name) for name in numbers_of(model["type"])}, **model}
        for uid, model in simulation.get("actors", {}).items()
    }
    return {**document, "edits": edits, "simulation": {**simulation, **({"actors": actors} if actors else {})}}


def sweep_document(name: str, scenario: str, parameters: Sequence[Parameter], driver: str | None) -> dict[str, Any]:
    """Return a sweep over a scenario's file, which lies beside it. Raises `UnisimError` where two parameters have one
    name."""
    names = [parameter.name for parameter in parameters]
    for parameter_name in names:
        if not parameter_name.strip() or names.count(parameter_name) > 1:
            raise UnisimError(f'parameter "{parameter_name}": each needs a name of its own')
    return {
        "format": "unisim-sweep",
        "version": 1,
        "name": name,
        "scenario": scenario,
        **({} if driver is None else {"driver": driver}),
        "parameters": {parameter.name: parameter.document() for parameter in parameters},
    }


def parsed_values(text: str) -> tuple[Any, ...]:
    """Return the values of a list: "0, 2.5, car-01". What is no JSON is taken as a text."""
    return tuple(_value(part.strip()) for part in text.split(",") if part.strip())


def _value(text: str) -> Any:
    try:
        return json.loads(text, parse_constant=str)
    except ValueError:
        return text


def _leaves(value: Any, path: tuple[str | int, ...]) -> Iterator[tuple[tuple[str | int, ...], float | str]]:
    if isinstance(value, dict):
        for name, member in value.items():
            if name not in _LEFT_OUT:
                yield from _leaves(member, (*path, name))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _leaves(item, (*path, index))
    elif isinstance(value, int | float | str) and not isinstance(value, bool):
        yield path, value


def _words(path: tuple[str | int, ...]) -> tuple[str, float]:
    """Return what the field at a path is called, with its unit, and the reach of its range at first."""
    name = next(part for part in reversed(path) if isinstance(part, str))
    number = path[-1] if isinstance(path[-1], int) else None
    unit = next((UNITS[end] for end in sorted(UNITS, key=len, reverse=True) if name.endswith(f"_{end}")), "")
    key = name.removeprefix("world_") if number is None else f"{name.removeprefix('world_')}/{number}"
    words, reach = WORDS.get(f"{path[0]}/{key}", WORDS.get(key, ("", 0.0)))
    if name.startswith("world_"):
        words = WORDS[f"position/{number}"][0]
    elif not words:
        plain = name.removesuffix(next((f"_{end}" for end in UNITS if name.endswith(f"_{end}")), ""))
        words = plain.replace("_", " ") + ("" if number is None else f" {number + 1}")
    if name == "position":
        unit = "m"
    return (Text("{what} ({unit})", what=Text(words), unit=unit) if unit else Text(words)), reach


def _owner(document: dict[str, Any], path: tuple[str | int, ...]) -> str:
    """Return whose field it is: the id of an actor or a sensor, or what it belongs to."""
    if path[0] == "simulation":
        if path[1:2] != ("actors",):
            return Text("Simulation")
        return Text("All others") if path[2] == OTHER_ACTORS else str(path[2])
    owners: list[dict[str, Any]] = []
    value: Any = document
    for part in path:
        value = value[part]
        if isinstance(value, dict):
            owners.append(value)
    ids = [str(owner[name]) for owner in reversed(owners) for name in ("id", "actor", "box") if name in owner]
    return ids[0] if ids else Text("Ego vehicle") if path[0] == "edits" else Text("Sensors")


def _escaped(part: str | int) -> str:
    """Return a part of a JSON pointer (RFC 6901)."""
    return str(part).replace("~", "~0").replace("/", "~1")


def write_jobs(read: dict[str, Scenario], sweeps: dict[str, Any], folder: Path) -> list[Path]:
    """Write scenarios and sweeps, and return the files that are the jobs. Raises `UnisimError`."""
    folder.mkdir(parents=True, exist_ok=True)
    jobs = []
    for name, scenario in read.items():
        write_scenario(scenario, folder / f"{name}.json")
        jobs.append(folder / f"{name}.json")
        if name in sweeps:
            jobs[-1] = folder / f"{name}.sweep.json"
            write_file(jobs[-1], json_bytes(sweeps[name]))
    return jobs
