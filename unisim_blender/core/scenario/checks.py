"""What makes a scenario document valid, without its log: the published schema first, then what a schema cannot say."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ScenarioError
from .limits import check_limits, place_in
from .times import check_times
from .types import (
    CameraSpec,
    CopyStatic,
    Duplicate,
    Edit,
    Ego,
    EgoBody,
    FrameRange,
    Insert,
    InsertMesh,
    Keyframe,
    LidarSpec,
    Move,
    RemoveStatic,
    Retime,
    Rotation,
    Scale,
    Scenario,
    ShiftKey,
)

SCALE_BOUNDS = 0.1, 10.0
"""Of an actor's size along each axis, in parts of its look's own; both are allowed."""
UNSCALABLE = f"must lie between {SCALE_BOUNDS[0]:g} and {SCALE_BOUNDS[1]:g} along each axis"
QUATERNION_TOLERANCE = 1e-3
"""How far from 1 a quaternion's length may be, for those written by hand."""


@cache
def scenario_schema() -> dict[str, Any]:
    """The published JSON Schema of scenario documents."""
    schema: dict[str, Any] = json.loads(files(__package__).joinpath("schema.json").read_text(encoding="utf-8"))
    return schema


def check_document(document: Any, path: Path) -> None:
    """Raise `ScenarioError` for the first fault, in the file's order, that the schema finds in a JSON value."""
    check_by_schema(document, scenario_schema(), path)


def check_by_schema(document: Any, schema: dict[str, Any], path: Path) -> None:
    """Raise `ScenarioError` for the first fault that a schema, with ``format`` and ``version``, finds in a file's JSON value."""
    from jsonschema import Draft202012Validator  # here, so that scenarios can be written where only numpy is installed

    if isinstance(document, dict) and document.get("format") == schema["properties"]["format"]["const"]:
        version = document.get("version")
        if isinstance(version, int) and version > 1:
            raise ScenarioError(f"{path}: has version {version}, newer than the 1 that this program reads")
    check_limits(document, path)
    faults = Draft202012Validator(schema).iter_errors(document)
    first = min(faults, key=lambda fault: [str(step).zfill(8) for step in fault.absolute_path], default=None)
    if first is not None:
        message = first.message if len(first.message) <= 200 else f"{first.message[:120]} … {first.message[-60:]}"
        raise ScenarioError(f"{place_in(path, tuple(first.absolute_path))}: {message}")


def check_scenario(scenario: Scenario) -> None:
    """Raise `ScenarioError` for what contradicts itself: ids, rotations, times, choices that exclude each other."""
    path = scenario.path
    if isinstance(scenario.frames, FrameRange):
        start, stop = scenario.frames.start or 0, scenario.frames.stop
        _require(stop is None or start < stop, f"{path}: frames", f"stop {stop} must lie beyond start {start}")
    check_times(scenario)
    for key, box in (scenario.boxes or {}).items():
        check_rotation(box, f"{path}: boxes.{key}")
        _require(min(box.size_m) > 0, f"{path}: boxes.{key}.size_m", f"must be above 0, not {list(box.size_m)}")
    taken = {key: f"boxes.{key}" for key in scenario.boxes or {}}
    for index, edit in enumerate(scenario.edits):
        place = f"{path}: edits[{index}]"
        check_edit(edit, place)
        if isinstance(edit, CopyStatic | RemoveStatic) and edit.box not in (scenario.boxes or {}):
            raise ScenarioError(f'{place}.box: no box "{edit.box}" {listed(scenario.boxes or {})}')
        new = getattr(edit, "id", None)
        if new is not None:
            _require(new not in taken, f"{place}.id", f'"{new}" is taken by {taken.get(new)}')
            taken[new] = f"edits[{index}]"
    _check_sensors(scenario)


def _check_sensors(scenario: Scenario) -> None:
    if scenario.sensors is None:
        return
    both: dict[str, tuple[CameraSpec | LidarSpec, ...]] = {
        "cameras": scenario.sensors.cameras or (),
        "lidars": scenario.sensors.lidars or (),
    }
    for kind, specs in both.items():
        seen: set[str] = set()
        for index, spec in enumerate(specs):
            place = f"{scenario.path}: sensors.{kind}[{index}]"
            _require(spec.id not in seen, f"{place}.id", f'"{spec.id}" stands twice')
            seen.add(spec.id)
            given = [name for name in ("mount", "mount_offset", "trajectory") if getattr(spec, name) is not None]
            _require(len(given) <= 1, place, f"has both {' and '.join(given)}, which exclude each other")
            _check_keys(spec.trajectory or (), f"{place}.trajectory")
            for member, rotation in (("mount", spec.mount), ("mount_offset", spec.mount_offset)):
                if rotation is not None:
                    check_rotation(rotation, f"{place}.{member}")


def check_edit(edit: Edit, place: str) -> None:
    """Raise `ScenarioError` for what an edit alone shows to be wrong."""
    if isinstance(edit, Duplicate):
        displaced = {
            name for name in ("offset_m", "world_offset_m", "turn_deg", "time_offset_s") if getattr(edit, name) is not None
        }
        placed = edit.pose is not None or edit.trajectory is not None
        _require(not (displaced and placed), place, f"has {', '.join(sorted(displaced))} beside a path of its own")
    if isinstance(edit, Duplicate | Insert | InsertMesh | Move):
        given = [name for name in ("pose", "trajectory") if getattr(edit, name) is not None]
        least = 0 if isinstance(edit, Duplicate) else 1
        _require(least <= len(given) <= 1, place, "needs pose or trajectory, one of them")
        _require(edit.outside is None or edit.trajectory is not None, f"{place}.outside", "needs a trajectory")
        if edit.pose is not None:
            check_rotation(edit.pose, f"{place}.pose")
        if edit.trajectory is not None:
            _check_keys(edit.trajectory, f"{place}.trajectory")
        if edit.present is not None and edit.present.start_s is not None and edit.present.end_s is not None:
            start, end = edit.present.start_s, edit.present.end_s
            _require(start <= end, f"{place}.present", f"end_s {end} lies before start_s {start}")
    elif isinstance(edit, Retime):
        _check_retime(edit, place)
    elif isinstance(edit, Scale):
        _require(scales(edit.factors), f"{place}.factors", f"{list(edit.factors)} {UNSCALABLE}")
    elif isinstance(edit, CopyStatic):
        check_rotation(edit.target, f"{place}.target")
    elif isinstance(edit, EgoBody):
        check_rotation(edit.mount, f"{place}.mount")
    elif isinstance(edit, Ego):
        given = [name for name in ("shift_left_m", "shift", "trajectory") if getattr(edit, name) is not None]
        _require(len(given) == 1, place, "needs shift_left_m, shift or trajectory, one of them")
        _require(edit.outside is None or edit.trajectory is not None, f"{place}.outside", "needs a trajectory")
        _check_keys(edit.trajectory or (), f"{place}.trajectory")
        _check_keys(edit.shift or (), f"{place}.shift")


def scales(factors: Sequence[float]) -> bool:
    """Whether an actor can be scaled by these factors along its axes."""
    return all(SCALE_BOUNDS[0] <= factor <= SCALE_BOUNDS[1] for factor in factors)


def _check_retime(edit: Retime, place: str) -> None:
    if edit.map is None:
        _require(edit.offset_s is not None or edit.speed is not None, place, "needs offset_s, speed or map")
        _require(edit.pivot_s is None or edit.speed is not None, f"{place}.pivot_s", "needs a speed")
        _require(edit.speed is None or edit.speed > 0, f"{place}.speed", f"must be above 0, not {edit.speed}")
        return
    alone = edit.offset_s is None and edit.speed is None and edit.pivot_s is None
    _require(alone, place, "has offset_s, speed or pivot_s beside map, which exclude each other")
    for index, ((before, recorded_before), (after, recorded)) in enumerate(zip(edit.map, edit.map[1:], strict=False), 1):
        _require(after > before, f"{place}.map[{index}]", f"scenario time {after} must lie after {before}")
        _require(
            recorded >= recorded_before,
            f"{place}.map[{index}]",
            f"recorded time {recorded} must not lie before {recorded_before}",
        )


def _check_keys(keys: Sequence[Keyframe | ShiftKey], place: str) -> None:
    for index, key in enumerate(keys):
        here = f"{place}[{index}]"
        _require((key.time_s is None) != (key.frame is None), here, "needs time_s or frame, one of them")
        if isinstance(key, Keyframe):
            check_rotation(key, here)
        for unit in ("time_s", "frame"):
            last, now = getattr(keys[index - 1], unit) if index else None, getattr(key, unit)
            if last is not None and now is not None:
                _require(now > last, f"{here}.{unit}", f"{now} must lie after the key before, {last}")


def check_rotation(rotation: Rotation, place: str) -> None:
    """Raise `ScenarioError` for a rotation given twice and for a quaternion whose length is not 1."""
    angles = (rotation.yaw_deg, rotation.pitch_deg, rotation.roll_deg)
    if rotation.quaternion_wxyz is None:
        return
    _require(angles == (None, None, None), place, "has angles beside quaternion_wxyz, which exclude each other")
    length = float(np.linalg.norm(rotation.quaternion_wxyz))
    _require(
        abs(length - 1) <= QUATERNION_TOLERANCE,
        f"{place}.quaternion_wxyz",
        f"{list(rotation.quaternion_wxyz)} has length {length:.6g}, not 1",
    )


def listed(names: Iterable[str]) -> str:
    """The names there are, in brackets, the middle left out where there are many."""
    known = sorted(names)
    if not known:
        return "(there are none)"
    if len(known) <= 6:
        return f"(there are {', '.join(known)})" if len(known) > 1 else f"(there is {known[0]})"
    return f"(there are {known[0]} … {known[-1]})"


def _require(holds: bool, place: str, problem: str) -> None:
    if not holds:
        raise ScenarioError(f"{place}: {problem}")
