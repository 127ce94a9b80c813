"""Reader of logs that are named by a file of boxes (`tracks.box_file`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..data.log import Log
from ..errors import LogError
from ..tracks.box_file import BoxFile, boxed_log, is_box_file, read_boxes


class BoxFileReader:
    """Recognises files of boxes, and opens the log that one names, by ``open_log``, with its boxes."""

    name = "boxes"
    layout = "a file of boxes, which names its log"
    suffixes: tuple[str, ...] = (".json",)

    def __init__(self, open_log: Callable[[Path], Log]) -> None:
        self._open_log = open_log

    def recognises(self, path: Path) -> bool:
        """Whether a file states that it is one of boxes."""
        return is_box_file(path)

    def open(self, path: Path) -> Log:
        """Open the log that the file names. Raises `LogError`."""
        boxes = read_boxes(path)
        recorded = named_log(boxes)
        if not recorded.exists():
            raise LogError(f"{path}: log: there is none at {recorded}")
        if is_box_file(recorded):
            raise LogError(f"{path}: log: {recorded} is a file of boxes, too")
        return boxed_log(self._open_log(recorded), boxes)


def named_log(boxes: BoxFile) -> Path:
    """Return the log that a file of boxes names. Raises `LogError` where it names none."""
    if boxes.log is None:
        raise LogError(f'{boxes.path}: names no log: give it the member "log", or name it by --boxes beside a log')
    return boxes.log
