"""Scenario documents: read, checked, applied, moved to another file, and written. Reading and writing a document
preserves it, up to former names."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from ..errors import ScenarioError
from ..files import write_file
from ..geometry import TrajectoryError
from ..json_file import check_finite, read_json
from ..remote.requests import beside, is_url
from ..sensors.frames import FORMER_PASSES
from ..world.drive import Drive
from . import edits  # noqa: F401 so that all are registered before a document is read
from .checks import fail, require
from .context import EditContext, RecordedLamps, SceneActors
from .edit import EDITS, Edit
from .light import check_light, sun_of
from .motion.placement import check_rotation
from .schema import FORMAT, VERSION, check_document
from .sensors.document import check_sensors
from .sensors.select import select_sensors
from .simulation import check_simulation
from .times import check_times
from .types import RECORDED, FrameRange, Scenario, StreetLog
from .weather import check_weather, weather_of

__all__ = [
    "FORMAT", "VERSION", "apply_scenario", "at_url", "build", "check_scenario", "load_scenario", "plain", "rebased",
    "save_scenario", "scenario_from_json", "scenario_to_json",
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
    write_file(Path(path), json.dumps(document, indent=2, ensure_ascii=False) + "\n", ScenarioError)


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
        own_first = sorted(
            fields(value), key=lambda item: bool(item.kw_only)
        )  # members of a base are written after its own
        members = {item.name: getattr(value, item.name) for item in own_first}
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


def check_scenario(scenario: Scenario) -> None:
    """Raise `ScenarioError` for what contradicts itself: ids, rotations, times, choices that exclude each other."""
    path = scenario.path
    if isinstance(scenario.frames, FrameRange):
        start, stop = scenario.frames.start or 0, scenario.frames.stop
        require(stop is None or start < stop, f"{path}: frames", f"stop {stop} must lie beyond start {start}")
    check_times(scenario)
    for key, box in (scenario.boxes or {}).items():
        check_rotation(box, f"{path}: boxes.{key}")
        require(min(box.size_m) > 0, f"{path}: boxes.{key}.size_m", f"must be above 0, not {list(box.size_m)}")
    taken = {key: f"boxes.{key}" for key in scenario.boxes or {}}
    for index, edit in enumerate(scenario.edits):
        place = f"{path}: edits[{index}]"
        edit.check(scenario, place)
        new = getattr(edit, "id", None)
        if new is not None:
            require(new not in taken, f"{place}.id", f'"{new}" is taken by {taken.get(new)}')
            taken[new] = f"edits[{index}]"
    if scenario.sensors is not None:
        check_sensors(scenario.sensors, f"{path}: sensors")
    if scenario.weather is not None:
        check_weather(scenario.weather, f"{path}: weather")
    if scenario.light is not None:
        check_light(scenario.light, f"{path}: light")
    if scenario.simulation is not None:
        check_simulation(scenario.simulation, f"{path}: simulation")


def rebased(scenario: Scenario, path: Path, absolute: bool = False) -> Scenario:
    """Return a scenario whose file is ``path``: what it names lies where it lay. ``absolute`` writes whole paths, for
    files that lie in no file system. URLs stay as they are."""

    def moved(name: str) -> str:
        if is_url(name):
            return name
        there = scenario.resolve(name)
        return there.as_posix() if absolute else Path(os.path.relpath(there, path.parent.resolve())).as_posix()

    return replace(_renamed(scenario, moved), path=path)


def at_url(scenario: Scenario, url: str) -> Scenario:
    """Return a scenario that was read from a URL: what its relative paths name lies beside it there."""
    return _renamed(scenario, lambda name: beside(url, name))


def _renamed(scenario: Scenario, moved: Callable[[str], str]) -> Scenario:
    """Return a scenario with other names of its log, scenes and meshes."""
    log: str | StreetLog = scenario.log
    log = moved(log) if isinstance(log, str) else replace(log, path=moved(log.path))
    scene = scenario.scene if scenario.scene in (None, RECORDED) else moved(str(scenario.scene))
    renamed = []
    for edit in scenario.edits:
        named: dict[str, Any] = {
            name: moved(getattr(edit, name))
            for name in ("scene", *edit.meshes)
            if getattr(edit, name, None) is not None
        }
        renamed.append(replace(edit, **named) if named else edit)
    return replace(scenario, log=log, scene=scene, edits=tuple(renamed))


def apply_scenario(
    scenario: Scenario, base_drive: Drive, scene_actors: SceneActors, recorded_lamps: RecordedLamps | None = None
) -> Drive:
    """Return the edited drive. ``base_drive`` is not changed; the result shares the objects that no edit changes.

    ``scene_actors`` returns the actors of another trained scene, given its folder, and ``recorded_lamps`` the lamps of the
    log's actors. Raises `ScenarioError` naming the edit's place.
    """
    context = EditContext(scenario, base_drive, scene_actors, recorded_lamps)
    for key in scenario.boxes or {}:
        if key in base_drive.actors:
            fail(f"{scenario.path}: boxes.{key}", "is an actor's id already")
    drive, place = base_drive, ""
    try:
        for index, edit in enumerate(scenario.edits):
            place = f"{scenario.path}: edits[{index}]"
            drive = edit.apply(drive, place, context)
        place = f"{scenario.path}: sensors"
        return select_sensors(in_weather_and_light(select_frames(drive, scenario), scenario, base_drive), context)
    except TrajectoryError as fault:
        fail(place, str(fault))


def in_weather_and_light(drive: Drive, scenario: Scenario, recorded: Drive) -> Drive:
    """Return the edited drive in the scenario's weather and light. Raises `ScenarioError`."""
    if scenario.weather is not None:
        drive = replace(drive, weather=weather_of(scenario.weather))
    if scenario.light is not None:
        drive = replace(drive, sun=sun_of(scenario.light))
    return with_edited(drive, recorded)


def with_edited(drive: Drive, recorded: Drive) -> Drive:
    """Return the drive with the ids of the actors that its edits made or changed, where a sun needs them."""
    if drive.sun is None:
        return drive
    own = {uid for uid, actor in drive.actors.items() if actor is not recorded.actors.get(uid)}
    return replace(drive, edited=recorded.edited | own)


def select_frames(drive: Drive, scenario: Scenario) -> Drive:
    """Return the drive with the scenario's frames. A range skips frames that the log lacks; a list that names
    one is an error."""
    if scenario.frames is None:
        return drive
    place, span = f"{scenario.path}: frames", f"({drive.frames[0]} … {drive.frames[-1]})"
    if isinstance(scenario.frames, FrameRange):
        last = drive.frames[-1] + 1
        stop = last if scenario.frames.stop is None else scenario.frames.stop
        if stop > last:
            fail(f"{place}.stop", f"no frame {stop - 1} in the log {span}")
        wanted = range(scenario.frames.start or 0, stop, scenario.frames.step or 1)
        frames = tuple(frame for frame in drive.frames if frame in wanted)
        if not frames:
            fail(place, f"selects none of the frames there are {span}")
        return replace(drive, frames=frames)
    for index, frame in enumerate(scenario.frames):
        if frame not in drive.time_s:
            fail(f"{place}[{index}]", f"no frame {frame} in the log {span}")
    return replace(drive, frames=tuple(scenario.frames))
