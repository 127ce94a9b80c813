"""The recorded drive that a scene was imported from, opened again whenever it is needed, and the opened trained scenes.

It is the float64 original that edits are compared with. Opening takes a second, so the newest one is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ...core.data.log import Log
from ...core.errors import LogError, UnisimError, what_is_missing
from ...core.formats.readers import open_log
from ...core.model.scene_file import HEADER_NAME, read_scene_header
from ...core.prepare.replay import aligned_log, replayed_drive
from ...core.scenes.scene import OpenScenes
from ...core.world.drive import Box, Drive
from ...core.world.replay import parked_boxes

OPENED = OpenScenes()
scene_actors = OPENED.actors
"""Gives the actors of the scene in a folder, as edits ask for them."""


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
    found = _newest.get(key)
    if found is None:
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
        found = DriveSource(log_path, scene_path, drive, recorded, parked)
        _newest.clear()
        _newest[key] = found
    return found


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
