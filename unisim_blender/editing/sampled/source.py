"""The recorded drive that a scene was imported from, opened again whenever it is needed, and the opened trained scenes.

It is the float64 original that edits are compared with. Opening takes a second, so the newest one is cached. A file
that is dropped onto the window leads to the operator that imports it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ...core.data.log import Log
from ...core.errors import LogError, UnisimError, what_is_missing
from ...core.formats.readers import open_log, reader_of
from ...core.json_file import read_json
from ...core.model.scene_file import HEADER_NAME, read_scene_header
from ...core.prepare.replay import aligned_log, replayed_drive
from ...core.rigs import FORMAT as RIG_FORMAT
from ...core.scenario import FORMAT
from ...core.scenes.scene import OpenScenes
from ...core.world.drive import Actor, Box, Drive
from ...core.world.replay import parked_boxes
from ..texts import Text, counted, series

OPENED = OpenScenes()
scene_actors = OPENED.actors
"""Gives the actors of the scene in a folder, as edits ask for them."""


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
            raise NotImported(f"{log_path}: there is no log")
        source = DriveSource(log_path, scene_path, drive, recorded, parked)
        _newest.clear()
        _newest[key] = source
    return source


def _opened(path: Path) -> Log:
    try:
        return open_log(path)
    except ImportError as fault:
        sentence = what_is_missing(fault)
        if not sentence:
            raise
        raise LogError(f"{path}: {sentence}") from fault


def _changed(path: Path | None) -> float:
    if path is None:
        return 0.0
    file = path / HEADER_NAME
    return file.stat().st_mtime if file.is_file() else 0.0


def dropped(path: Path) -> tuple[str, Path]:
    """Return the operator for a file, and the path that it takes.

    The file's name tells, or the folders round it: the window gives files alone, and a log is a folder.
    """
    # a rendered sequence has its scenario beside a log's folders
    stated = format_of(path) if path.suffix.lower() == ".json" else ""
    if stated == RIG_FORMAT:
        return "apply_rig", path
    if path.name == HEADER_NAME:
        return "import_scene", path
    places = () if stated == FORMAT else (path, *path.parents[:3])
    log = next((place for place in places if reader_of(place) is not None), None)
    return ("import_scenario", path) if log is None else ("import_log", log)


def format_of(path: Path) -> str:
    """Return the format that a JSON file states; "" where it states none."""
    try:
        document = read_json(path, UnisimError)
    except UnisimError:
        return ""
    return str(document.get("format", "")) if isinstance(document, dict) else ""


def summary(source: DriveSource) -> str:
    """Return what a drive holds, as one line."""
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
        counted(len(drive.cameras), "1 camera", "{count} cameras"),
        counted(len(drive.lidars), "1 LiDAR", "{count} LiDARs"),
        actors,
    ]
    scene = source.scene_path
    trained = Text("no trained scene") if scene is None else Text("trained scene {name}", name=scene.name)
    what = [trained] if source.log is not None else [trained, Text("the log itself is not at hand")]
    return Text(
        "Imported {log}: {parts}; {what}", log=source.log_path.name, parts=series(parts), what=series(what, "; ")
    )
