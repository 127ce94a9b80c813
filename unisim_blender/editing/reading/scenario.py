"""A Blender scene read as a scenario: the difference between what was imported and what stands there.

What lies within a tenth of a millimetre of the import at every frame is unedited and keeps its float64 original.
Members that no object represents (frames or times, sensors' own times, what moves outside the recording,
description) are text in the scene, and an export writes them back. Meshes are written beside the scenario; until then they
lie in this process's own folder, each in a file named after a digest of its content.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...core.errors import OutputError, ScenarioError, in_a_line, refused
from ...core.files import partial_file
from ...core.meshes.model import SUFFIX, MeshModel, write_model
from ...core.scenario import save_scenario, scenario_from_json, scenario_to_json
from ...core.scenario.sensors.document import CameraSpec, LidarSpec, Sensors
from ...core.scenario.time_range import TimeRange, Times
from ...core.scenario.times import scenario_times_us, sensors_with_times
from ...core.scenario.types import FrameRange, Outputs, Scenario
from ...core.world.captures import US_PER_SECOND, CaptureKey, time_name
from ...core.world.drive import Drive
from .. import readers  # noqa: F401 so that all are registered
from ..edits.lines import EditLine, problem_line
from ..edits.reader import GROUPS, ReadContext
from ..readers.actors import unreadable
from ..readers.sensors import sensors_of
from ..sampled.scene import Sampled
from ..sampled.source import DriveSource
from ..texts import Text, counted

GROUP_OF = {kind: reader.group for reader in GROUPS for kind in reader.kinds}
"""Groups of objects that are read together, by the objects' kinds."""
BY_ID = {reader.group for reader in GROUPS if reader.by_id}
"""Groups of which each id is one of its own."""


def read_scenario(
    sampled: Sampled, source: DriveSource, path: Path, frames: FrameRange | None = None, outputs: Outputs | None = None
) -> Scenario:
    """The scenario that a sampled scene stands for; its paths are relative to ``path``, where it is
    meant to be written.

    Raises `UnisimError` where another trained scene that an appearance comes from cannot be read.
    """
    drive = source.drive
    reading = _reading(sampled, drive, lambda name: relative(Path(name), path))
    edits = tuple(edit for reader in GROUPS for edit in reader.edits(reading))
    return Scenario(
        name=sampled.name,
        log=relative(source.log_path, path),
        scene=None if source.scene_path is None else relative(source.scene_path, path),
        frames=frames,
        sensors=sensors_of(sampled, drive),
        boxes=reading.boxes or None,
        edits=edits,
        weather=sampled.weather,
        light=sampled.light,
        outputs=outputs,
        path=path,
    )


def _reading(sampled: Sampled, drive: Drive, named: Callable[[str], str] = str) -> ReadContext:
    """Return the readers' context of a sampled scene. ``named`` gives a file or a folder as the scenario names it."""
    return ReadContext(sampled, drive, {*drive.actors, *(obj.uid for obj in sampled.of("STATIC"))}, named)


def unreadable_actors(sampled: Sampled, drive: Drive) -> dict[str, str]:
    """Return why actors' objects cannot be read, in words after the object's name, by the objects' names."""
    faults = unreadable(_reading(sampled, drive))
    return {name: str(fault).removeprefix(f'object "{name}": ') for name, fault in faults.items()}


def edited_ids(sampled: Sampled, drive: Drive) -> set[str]:
    """Ids of recorded actors and sensors that do not stand as they were imported, missing ones too; "ego"
    for the vehicle."""
    reading = _reading(sampled, drive)
    return {uid for reader in GROUPS for uid in reader.edited_ids(reading)}


def group_lines(group: str, uid: str, sampled: Sampled, drive: Drive) -> Iterator[EditLine]:
    """Yield the lines of objects that are read together; where they cannot be read, one that says why."""
    try:
        for reader in GROUPS:
            if reader.group == group:
                yield from reader.lines(_reading(sampled, drive), uid)
    except ScenarioError as fault:
        yield problem_line(group, uid, fault, sampled.objects)


def relative(target: Path, file: Path) -> str:
    """``target`` as a scenario in ``file`` names it."""
    try:
        return Path(os.path.relpath(target, file.parent)).as_posix()
    except ValueError as fault:
        if os.name == "nt":  # there is no relative path to another drive
            return target.as_posix()
        raise ScenarioError(f"{file}: {target}: {fault}") from fault


_IMPORTED = Path("the scenario that was imported")


def stated_text(scenario: Scenario) -> str:
    """Return what a scenario states besides its edits and sensors, as text; "" where that is nothing."""
    timed = [spec for _, _, spec in sensors_with_times(scenario)]
    own = Sensors(
        tuple(CameraSpec(spec.id, times=spec.times) for spec in timed if isinstance(spec, CameraSpec)) or None,
        tuple(LidarSpec(spec.id, times=spec.times) for spec in timed if isinstance(spec, LidarSpec)) or None,
    )
    stated = Scenario(
        name="kept",
        log="log",
        description=scenario.description,
        frames=scenario.frames,
        times=scenario.times,
        outside=scenario.outside,
        sensors=own if timed else None,
    )
    return "" if stated == Scenario(name="kept", log="log") else json.dumps(scenario_to_json(stated))


def with_stated(scenario: Scenario, text: str, drive: Drive, captures: bool) -> Scenario:
    """Return a scenario read from a scene with what its text states. Frames and times are taken over where ``captures``
    holds; else those of ``scenario`` stay. Raises `ScenarioError` for a text that is none."""
    if not text:
        return scenario
    stated = _read(text)
    # files of earlier versions have the simulation and the formats in their text
    merged = replace(
        scenario,
        description=stated.description,
        outside=stated.outside,
        simulation=stated.simulation,
    )
    if stated.outputs is not None and scenario.outputs is not None and scenario.outputs.formats is None:
        merged = replace(merged, outputs=replace(scenario.outputs, formats=stated.outputs.formats))
    if not captures:
        return merged
    sensors = _with_times(scenario.sensors, _sensor_times(stated), drive)
    return replace(merged, frames=stated.frames, times=stated.times, sensors=sensors)


def names_captures(text: str) -> bool:
    """Return whether a scene's text states frames or times; a text that is none states nothing."""
    try:
        stated = _read(text) if text else None
    except ScenarioError:
        return False
    return stated is not None and (stated.frames, stated.times, stated.sensors) != (None, None, None)


def captures_words(text: str) -> str:
    """Return which captures a scene's text states, as the panel says it. Raises `ScenarioError` for a text that is
    none."""
    stated = _read(text)
    own = _sensor_times(stated)
    if stated.times is not None:
        return _times_words(stated.times)
    if own:
        return counted(len(own), "1 sensor at times of its own", "{count} sensors at times of their own")
    frames = stated.frames if isinstance(stated.frames, tuple) else ()
    return counted(len(frames), "1 listed frame", "{count} listed frames") if frames else Text("Frames of the scenario")


def moment_keys(scenario: Scenario, drive: Drive, frames: Sequence[int]) -> set[CaptureKey]:
    """Return the keys of the moments that a scenario of a drive renders, of which ``frames`` are taken where it has no
    times. Raises `ScenarioError`."""
    times, own = scenario_times_us(scenario, drive)
    at: set[CaptureKey] = {time_name(time) for some in (times or (), *own.values()) for time in some}
    return at if times is not None else at | set(frames)


def span_s(scenario: Scenario, drive: Drive) -> tuple[float, float] | None:
    """Return the first and the last time that a scenario states, in seconds; None where it states none.
    Raises `ScenarioError`."""
    times, own = scenario_times_us(scenario, drive)
    every = [time for some in (times or (), *own.values()) for time in some]
    return (min(every) / US_PER_SECOND, max(every) / US_PER_SECOND) if every else None


@lru_cache(maxsize=8)  # a panel asks at every redraw
def _read(text: str) -> Scenario:
    try:
        return scenario_from_json(json.loads(text), _IMPORTED)
    except (ValueError, RecursionError) as fault:
        raise ScenarioError(f"{_IMPORTED}: what the scene keeps of it cannot be read: {in_a_line(fault)}") from fault


def _times_words(times: Times) -> str:
    if not isinstance(times, TimeRange):
        return counted(len(times), "1 time", "{count} times")
    start, stop = times.start_s, times.stop_s
    if start is None and stop is None:
        return Text("{rate:g} Hz", rate=times.rate_hz)
    if stop is None:
        return Text("From {start:g} s, {rate:g} Hz", start=start, rate=times.rate_hz)
    return Text("{start:g} to {stop:g} s, {rate:g} Hz", start=start or 0.0, stop=stop, rate=times.rate_hz)


def _sensor_times(scenario: Scenario) -> dict[str, Times]:
    """Times of sensors that have their own, by "camera/NAME" and "lidar/NAME"."""
    return {name: spec.times for name, _, spec in sensors_with_times(scenario) if spec.times is not None}


def _with_times(sensors: Sensors | None, times: dict[str, Times], drive: Drive) -> Sensors | None:
    """Sensors with their own times; a list that was None for all of the log's is written out where one of them has
    some."""
    if not times:
        return sensors
    listed = sensors or Sensors()
    kinds = {name.partition("/")[0] for name in times}
    if listed.cameras is None and "camera" in kinds:
        listed = replace(listed, cameras=tuple(CameraSpec(name) for name in drive.cameras))
    if listed.lidars is None and "lidar" in kinds:
        listed = replace(listed, lidars=tuple(LidarSpec(name) for name in drive.lidars))
    return listed.with_times(
        lambda spec: times.get(f"{'camera' if isinstance(spec, CameraSpec) else 'lidar'}/{spec.id}")
    )


def write_scenario(scenario: Scenario, path: Path) -> None:
    """Write a scenario; models that lie in this process's own folder go into one beside it. Raises `UnisimError`."""
    edits = []
    for edit in scenario.edits:
        for member in edit.meshes:
            file = scenario.resolve(getattr(edit, member))
            if file.parent == folder():
                copy = path.parent / f"{path.stem}_meshes" / file.name
                _copy(file, copy)
                edit = replace(edit, **{member: copy.relative_to(path.parent).as_posix()})
        edits.append(edit)
    save_scenario(replace(scenario, edits=tuple(edits)), path)


def _copy(source: Path, target: Path) -> None:
    if target.is_file():  # named after what it holds
        return
    with refused(target, "written", OutputError):
        with partial_file(target) as temporary:
            shutil.copyfile(source, temporary)


def file_of(model: MeshModel) -> Path:
    """The model in a file named after what it holds, in this process's own folder."""
    digest = hashlib.sha256()
    for field in fields(MeshModel):
        value = getattr(model, field.name)
        for array in value if isinstance(value, tuple) else (value,):
            digest.update(f"{field.name} {array.dtype.str} {array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
    path = folder() / f"{digest.hexdigest()[:32]}{SUFFIX}"
    if not path.is_file():
        write_model(model, path)
    return path


def folder() -> Path:
    """Return the folder of this process's models, which is removed when it ends."""
    return Path(_folder().name).resolve()


@lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="unisim-meshes-")
