"""Imports: which operator takes a file that is dropped onto the window, and what a drive holds, as one line."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from ...core.errors import UnisimError
from ...core.formats.readers import reader_of
from ...core.json_file import read_json
from ...core.model.scene_file import HEADER_NAME
from ...core.rigs import FORMAT as RIG_FORMAT
from ...core.scenario import FORMAT
from ..sampled.source import DriveSource
from ..texts import Text, counted, series


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
