"""The recorded drive that a scene was imported from, opened again whenever it is needed, and the opened trained scenes.

It is the float64 original that edits are compared with. Opening takes a second, so the newest one is cached.
`recognised` says what a path is that was dropped onto the window or chosen.
"""

from __future__ import annotations

import fnmatch
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from ...core.actor_images.lamps import cached_lamps
from ...core.data.log import Log
from ...core.errors import LogError, UnisimError, remedy_of, what_is_missing
from ...core.formats.readers import folders_below, open_log, reader_of
from ...core.json_file import read_json
from ...core.model.scene_file import HEADER_NAME, read_scene_header
from ...core.prepare.replay import aligned_log, replayed_drive
from ...core.rigs import FORMAT as RIG_FORMAT
from ...core.scenario import FORMAT
from ...core.scenes.scene import OpenScenes
from ...core.simulation.rollout.steps import SCENARIO_NAME, STEPS_NAME
from ...core.world.drive import Actor, Box, Drive
from ...core.world.lamps import ActorLamp
from ...core.world.replay import parked_boxes
from ..texts import Text, counted, series

OPENED = OpenScenes()
scene_actors = OPENED.actors
"""Gives the actors of the scene in a folder, as edits ask for them."""
MOST_FILES, LARGEST_SCENARIO = 50, 4_000_000
"""Of the JSON files in a folder that are looked at for scenarios: how many, and how large in bytes."""


def shown_actor(uid: str, scene: str, drive: Drive) -> Actor | None:
    """Return the actor whose appearance an object has: of the trained scene in folder ``scene``, or of the drive where
    that is ""; None where it is not there."""
    try:
        return (scene_actors(Path(scene)) if scene else drive.actors).get(uid)
    except UnisimError:
        return None


@dataclass(frozen=True)
class DriveSource:
    """``log_path``, and ``scene_path`` where a trained scene is loaded; ``log`` is None where only the scene is at
    hand. ``parked`` are the boxes of parked actors that the static world does not hold, by their ids."""

    log_path: Path
    scene_path: Path | None
    drive: Drive
    log: Log | None
    parked: Mapping[str, Box]


@dataclass(frozen=True)
class ImportOptions:
    """Parts of a drive to import: patterns of sensors' names, and the first and last frame and the step. None leaves what was
    imported before, else it is everything."""

    sensors: tuple[str, ...] | None = None
    frames: tuple[int, int, int] | None = None

    def of_drive(self, drive: Drive, before: Collection[str]) -> tuple[set[str], tuple[int, int, int] | None]:
        """Return the sensors of a drive that are not imported, of which ``before`` were not, and the frames, the last at most
        the drive's. Raises `UnisimError` for sensors and frames that it does not have."""
        names = {*drive.cameras, *drive.lidars}
        chosen = names - set(before)
        if self.sensors is not None:
            chosen = set()
            for pattern in self.sensors or ("",):
                if not (matching := set(fnmatch.filter(names, pattern))):
                    raise UnisimError(f'sensors: "{pattern}" is none of {", ".join(sorted(names))}')
                chosen |= matching
        if self.frames is None:
            return names - chosen, None
        first, last, step = self.frames
        start, end = min(drive.time_s), max(drive.time_s)
        if not start <= first <= min(last, end):
            raise UnisimError(f"frames {first} to {last}: the drive has frames {start} to {end}")
        return names - chosen, (first, min(last, end), step)


class NotImported(UnisimError):
    """A Blender scene without a drive."""


_newest: dict[tuple[object, ...], DriveSource] = {}


def open_source(log: str, scene: str) -> DriveSource:
    """The drive of a log's folder, as the trained scene in folder ``scene`` replays it, where that is not "".

    Knows nothing of Blender, so a thread may call it. Raises `UnisimError`.
    """
    log_path = Path(log)
    scene_path = Path(scene) if scene else None
    key = (log_path, scene_path, *(_changed(path) for path in (log_path, scene_path)))
    source = _newest.get(key)
    if source is None:
        recorded = _opened(log_path) if log_path.exists() else None
        if scene_path is not None:
            header = read_scene_header(scene_path)
            recorded = recorded and aligned_log(header, recorded)
            drive = header.drive if recorded is None else replayed_drive(header, recorded)
            parked = header.parked
        elif recorded is not None:
            drive, parked = recorded.drive, parked_boxes(recorded.drive)
        else:
            raise NotImported(f"{log_path}: there is no log", remedy="log")
        source = DriveSource(log_path, scene_path, drive, recorded, parked)
        _newest.clear()
        _newest[key] = source
    return source


_lamps: list[tuple[DriveSource, Mapping[str, tuple[ActorLamp, ...]] | None]] = []
"""The newest drive whose lamps were looked for in the cache, and these."""


def lamps_of(source: DriveSource, again: bool = False) -> Mapping[str, tuple[ActorLamp, ...]] | None:
    """Return the lamps of a drive's actors by their ids, as they were found before; None where they were not. It looks in the
    cache once, unless ``again``."""
    if again or not _lamps or _lamps[0][0] is not source:
        _lamps[:] = [(source, None if source.log is None else cached_lamps(source.log))]
    return _lamps[0][1]


def _opened(path: Path) -> Log:
    try:
        return open_log(path)
    except ImportError as fault:
        sentence = what_is_missing(fault)
        if not sentence:
            raise
        raise LogError(f"{path}: {sentence}", remedy=remedy_of(fault)) from fault


def _changed(path: Path | None) -> float:
    if path is None:
        return 0.0
    file = path if path.is_file() else path / HEADER_NAME
    return file.stat().st_mtime if file.is_file() else 0.0


class Recognised(NamedTuple):
    """What a path is: ``kind`` is "log", "scene", "scenario", "rollout" or "rig"; ``path`` is its folder, of a scenario or
    a rig its file."""

    kind: str
    path: Path


def recognised(path: Path) -> list[Recognised]:
    """Return what a file or folder is, else what the file lies in, else what lies in the folder or up to two levels below.

    Raises `UnisimError` where that is nothing.
    """
    if path.is_dir():
        below = [path] if _kind_of(path) else folders_below(path, _kind_of)
        inside = [Recognised(_kind_of(folder), folder) for folder in below]
        inside = inside or [Recognised("scenario", file) for file in _scenarios_in(path)]
        if not inside:
            raise UnisimError(f"{path}: holds no drive, trained scene, scenario or rollout")
        return inside
    if not path.exists():
        raise UnisimError(f"{path}: there is no such file or folder")
    is_json = path.suffix.lower() == ".json"
    stated = format_of(path) if is_json else ""
    if stated == FORMAT and path.name == SCENARIO_NAME and is_rollout(path.parent):
        return [Recognised("rollout", path.parent)]
    # a rendered sequence has its scenario beside a log's folders
    for place in () if stated in (FORMAT, RIG_FORMAT) else (path, *path.parents[:3]):
        kind = _kind_of(place)
        if kind == "scene" and (place != path.parent or (is_json and path.name != HEADER_NAME)):
            continue  # no file of the scene's
        if kind:
            return [Recognised(kind, place)]
    return [Recognised("rig" if stated == RIG_FORMAT else "scenario", path)]


def _kind_of(place: Path) -> str:
    """Return what a folder is, or a file that is a whole log; "" where it is nothing."""
    if is_rollout(place):
        return "rollout"
    if (place / HEADER_NAME).is_file():
        return "scene"
    return "log" if reader_of(place) is not None else ""


def _scenarios_in(folder: Path) -> list[Path]:
    """Return the scenarios in a folder, by name."""
    files = islice(
        (file for file in sorted(folder.glob("*.json")) if file.stat().st_size < LARGEST_SCENARIO), MOST_FILES
    )
    return [file for file in files if format_of(file) == FORMAT]


def is_rollout(folder: Path) -> bool:
    """Return whether a folder holds a rollout that has come to its end."""
    return (folder / STEPS_NAME).is_file() and (folder / SCENARIO_NAME).is_file()


def format_of(path: Path) -> str:
    """Return the format that a JSON file states; "" where it states none."""
    try:
        document = read_json(path, UnisimError)
    except UnisimError:
        return ""
    return str(document.get("format", "")) if isinstance(document, dict) else ""


def summary(source: DriveSource, skipped: Collection[str] = ()) -> str:
    """Return what a drive holds, as one line; ``skipped`` are the sensors that were not imported."""
    drive = source.drive
    labels = Counter(actor.label for actor in drive.actors.values())
    most: list[str] = [f"{count} {label}" for label, count in labels.most_common(3)]
    if len(labels) > 3:
        most.append(Text("{count} others", count=sum(labels.values()) - sum(n for _, n in labels.most_common(3))))
    times = sorted(drive.time_s.values())
    actors: str = counted(len(drive.actors), "1 actor", "{count} actors")
    if labels:
        actors = Text("{actors} ({classes})", actors=actors, classes=series(most))
    parts = [
        Text("{count} frames ({time:.1f} s)", count=len(times), time=times[-1] - times[0]),
        counted(len(set(drive.cameras) - set(skipped)), "1 camera", "{count} cameras"),
        counted(len(set(drive.lidars) - set(skipped)), "1 LiDAR", "{count} LiDARs"),
        actors,
    ]
    scene = source.scene_path
    trained = Text("no trained scene") if scene is None else Text("trained scene {name}", name=scene.name)
    what = [trained] if source.log is not None else [trained, Text("the log itself is not at hand")]
    return Text(
        "Imported {log}: {parts}; {what}", log=source.log_path.name, parts=series(parts), what=series(what, "; ")
    )
