"""Sweeps: which fields of a scenario parameters may fill, and the documents that `unisim batch` takes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.errors import UnisimError
from ...core.files import write_file
from ...core.json_file import json_bytes
from ...core.scenario.types import Scenario
from ..reading.scenario import write_scenario

MEMBERS = ("edits", "simulation", "sensors")
"""Members of a scenario that parameters may lie in."""
_LEFT_OUT = ("type", "id", "mesh", "scene", "trajectory", "map")
"""Members that are no choice of a sweep: nobody varies one key of a trajectory."""
_AXES = "xyz"


@dataclass(frozen=True)
class ScenarioField:
    """A number or a text of a scenario, at a JSON pointer. ``label`` says which, ``name`` is short."""

    pointer: str
    label: str
    name: str
    value: float | str


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


def fields_of(document: dict[str, Any]) -> list[ScenarioField]:
    """Return the fields of a scenario, as a JSON value, that a parameter may fill."""
    fields = []
    for member in MEMBERS:
        for path, value in _leaves(document.get(member), (member,)):
            pointer = "".join(f"/{_escaped(part)}" for part in path)
            shown = [_shown(path, index) for index in range(2 if member == "edits" else 0, len(path))]
            label = " ".join([_owner(document, path), *shown])
            short = "_".join(shown[-2:] if isinstance(path[-1], int) else shown[-1:])
            fields.append(ScenarioField(pointer, label.strip(), short, value))
    return fields


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


def _shown(path: tuple[str | int, ...], index: int) -> str:
    """Return a part of a path for people: places have axes."""
    part = path[index]
    if isinstance(part, int) and index and path[index - 1] in ("position", "offset_m", "world_offset_m", "size_m"):
        return _AXES[part]
    return str(part)


def _owner(document: dict[str, Any], path: tuple[str | int, ...]) -> str:
    """Return the kind of an edit, and whose it is."""
    if path[0] != "edits":
        return ""
    edit = document["edits"][path[1]]
    return " ".join(str(edit[name]) for name in ("type", "id", "actor", "box") if name in edit)


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
