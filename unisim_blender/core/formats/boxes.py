"""Boxes of a log from a file of any known format, by its content."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from ..data.log import Log, extras_of
from ..errors import LogError
from ..files import cache_folder, file_stamp, write_file
from ..tracks.box_file import FORMAT, SUFFIX, BoxFile, in_world_of, is_box_file, read_boxes, text_of, tracks_of
from ..world.box_tracks import TrackedBoxes
from .boxed import named_log
from .readers import drive_in, open_log


def with_boxes(log: Path, boxes: Path) -> Path:
    """Return a file of boxes that opens as the log at ``log`` with the boxes of the file ``boxes``: this itself where
    it names that log, or else a copy among the user's cached files. Raises `LogError`, `OutputError`."""
    log = drive_in(log)
    if is_box_file(log):
        log = named_log(read_boxes(log))
    if is_box_file(boxes):
        content = read_boxes(boxes)
        if content.log is not None and content.log.resolve() == log.resolve():
            return boxes
    return _cached(open_boxes(log, boxes))


def open_boxes(log: Path, boxes: Path) -> BoxFile:
    """Return the boxes of a file in the world of the log at a path: a file of boxes, or one in the format of the log's
    dataset (`LogExtras.boxes_of`). Raises `LogError`."""
    recorded = open_log(log)
    rows = rows_of(recorded, boxes)
    if rows is None:
        content = replace(read_boxes(boxes), log=log)
    else:
        content = BoxFile(boxes, tracks_of(boxes, rows, boxes.name), boxes.name, log)
    return in_world_of(content, recorded.drive)


def rows_of(log: Log, boxes: Path) -> TrackedBoxes | None:
    """Return the boxes of a file in the format of a log's dataset; None of a file of boxes. Raises `LogError`."""
    if is_box_file(boxes):
        return None
    if not boxes.exists():
        raise LogError(f"{boxes}: there is no such file of boxes")
    read = extras_of(log).boxes_of
    if read is None:
        raise LogError(
            f'{boxes}: is no file of boxes, which begins with {{"format": "{FORMAT}"; {log.path} is in a layout that has no '
            "other such files"
        )
    return read(boxes)


def _cached(content: BoxFile) -> Path:
    assert content.log is not None
    text = f"{content.log.resolve()}{content.path.resolve()}{file_stamp(content.path)}"
    folder = cache_folder() / "boxes" / hashlib.sha256(text.encode()).hexdigest()[:32]
    path = folder / (content.path.name.removesuffix(".json").removesuffix(".boxes") + SUFFIX)
    write_file(path, text_of(replace(content, path=path)).encode())
    return path
