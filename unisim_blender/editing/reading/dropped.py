"""Which operator imports a file that is dropped onto the window."""

from __future__ import annotations

from pathlib import Path

from ...core.errors import UnisimError
from ...core.formats.readers import reader_of
from ...core.json_file import read_json
from ...core.model.files.scene_file import HEADER_NAME
from ...core.rigs import FORMAT as RIG_FORMAT
from ...core.scenario import FORMAT


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
