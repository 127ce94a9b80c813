"""Scenario documents: read, checked, applied and written. Reading and writing a document preserves it, up
to former names."""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from ..errors import ScenarioError
from ..json_file import check_finite, read_json, write_text
from ..sensors.frames import FORMER_PASSES
from . import edits  # noqa: F401 so that all are registered before a document is read
from .apply import apply_scenario
from .checks import check_scenario
from .edit import EDITS, Edit
from .faults import require
from .schema import FORMAT, VERSION, check_document
from .types import Scenario

__all__ = [
    "FORMAT", "VERSION", "apply_scenario", "build", "load_scenario", "plain", "save_scenario", "scenario_from_json",
    "scenario_to_json",
]  # fmt: skip


def load_scenario(path: Path) -> Scenario:
    """Read and check a scenario. Raises `ScenarioError` naming the file, the place in it and the value."""
    path = Path(path)
    return scenario_from_json(read_json(path, ScenarioError), path)


def save_scenario(scenario: Scenario, path: Path) -> None:
    """Write a scenario, whole or not at all; the paths in it stay as they are. Raises `ScenarioError`."""
    document = scenario_to_json(scenario)
    check_finite(document, f"{path}: ", ScenarioError)
    check_scenario(scenario)
    write_text(Path(path), json.dumps(document, indent=2, ensure_ascii=False) + "\n", ScenarioError)


def scenario_from_json(document: Any, path: Path = Path("scenario.json")) -> Scenario:
    """Return the checked scenario of a JSON object. ``path`` is its file, which its paths are relative to
    and errors name.

    Raises `ScenarioError`.
    """
    check_finite(document, f"{path}: ", ScenarioError)
    document = _with_current_names(_with_current_passes(document), path)
    check_document(document, path)
    values = {key: value for key, value in document.items() if key not in ("format", "version")}
    scenario: Scenario = build(Scenario, values | {"path": path})
    check_scenario(scenario)
    return scenario


def _with_current_passes(document: Any) -> Any:
    """Return a JSON value that no schema has checked yet, with the current names of passes in place of former ones."""
    outputs = document.get("outputs") if isinstance(document, dict) else None
    if not isinstance(outputs, dict) or not isinstance(passes := outputs.get("passes"), list):
        return document
    current = [FORMER_PASSES.get(name, name) if isinstance(name, str) else name for name in passes]
    return {**document, "outputs": {**outputs, "passes": current}}


def _with_current_names(document: Any, path: Path) -> Any:
    """Return a JSON value that no schema has checked yet, with the current names of edits' members in
    place of former ones.

    Raises `ScenarioError` for an edit that has a member under both names.
    """
    changes = document.get("edits") if isinstance(document, dict) else None
    if not isinstance(changes, list):
        return document
    return {**document, "edits": [_current_edit(edit, f"{path}: edits[{index}]") for index, edit in enumerate(changes)]}


def _current_edit(edit: Any, place: str) -> Any:
    kind = EDITS.get(edit["type"]) if isinstance(edit, dict) and isinstance(edit.get("type"), str) else None
    if kind is None:
        return edit
    for former, current in kind.former_names.items():
        require(
            not {former, current} <= edit.keys(),
            place,
            f'has "{current}" and its former name "{former}": give one of them',
        )
    return {kind.former_names.get(key, key): value for key, value in edit.items()}


def scenario_to_json(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario as a JSON object."""
    values = plain(scenario)
    del values["path"]
    return {"format": FORMAT, "version": VERSION, **values}


def plain(value: Any) -> Any:
    """Return a part of a scenario as a JSON value, without members that are None."""
    if is_dataclass(value):
        head = {"type": value.type} if hasattr(value, "type") else {}
        members = {item.name: getattr(value, item.name) for item in fields(value)}
        return head | {key: plain(member) for key, member in members.items() if member is not None}
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return value


def build(hint: Any, value: Any) -> Any:
    """Return a JSON ``value`` that the schema accepts as an instance of the annotated type ``hint``."""
    if hint is Edit:
        kind = EDITS[value["type"]]
        return build(kind, {key: member for key, member in value.items() if key != "type"})
    origin, choices = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return build(next(choice for choice in choices if _accepts(choice, value)), value)
    if origin is tuple:
        items = choices if choices[-1] is not Ellipsis else choices[:1] * len(value)
        return tuple(build(item, part) for item, part in zip(items, value, strict=True))
    if origin is dict:
        return {key: build(choices[1], member) for key, member in value.items()}
    if is_dataclass(hint):
        hints = _hints(hint)  # type: ignore[arg-type]
        return hint(**{key: build(hints[key], member) for key, member in value.items()})  # type: ignore[operator]
    return int(value) if hint is int else value  # JSON Schema counts 2.0 among the integers


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _accepts(hint: Any, value: Any) -> bool:
    if isinstance(value, list):
        return get_origin(hint) is tuple
    if isinstance(value, dict):
        return is_dataclass(hint) or get_origin(hint) is dict
    return hint is type(value) or (hint in (int, float) and isinstance(value, int | float))
