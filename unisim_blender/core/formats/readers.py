"""`open_log`, and the readers that it asks: the package's own, and those of other packages by their entry points.

The package's own have no entry points, because these need the metadata of an installed distribution, which the package
lacks where it is run from its sources or as Blender's extension. Another of its own is a package beside `pandaset`
and its name in `OWN`. Another distribution registers a reader in its pyproject.toml:

    [project.entry-points."unisim_blender.logs"]
    name = "module:reader"
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Collection, Mapping
from itertools import islice
from pathlib import Path
from typing import Protocol

from ..data.log import Log
from ..data.values import check_times
from ..errors import LogError, in_a_line, short
from ..geometry import TrajectoryError
from ..memo import memoized
from ..registry import Registry
from ..remote.copies import FolderPart
from .argoverse2 import Argoverse2Reader
from .boxed import BoxFileReader
from .kitti import KittiReader
from .ncore import NcoreReader
from .nuscenes import NuscenesReader
from .pandaset import PandasetReader
from .waymo import WaymoReader


class Reader(Protocol):
    """A dataset's layout. An instance, or a class whose methods are static; what reads the log is imported by `open`
    alone."""

    name: str
    """One word, unique among readers: "pandaset"."""
    layout: str
    """How a person recognises the layout, for messages: "PandaSet: a folder with lidar/ and camera/"."""
    suffixes: tuple[str, ...]
    """Of the log's files that can be dropped onto Blender's window: (".json",)."""

    def recognises(self, path: Path) -> bool:
        """Whether the folder or file is a log in this layout. Only names are looked at, so that it costs nothing."""

    def open(self, path: Path) -> Log:
        """Open a log that `recognises` is true of. Raises `LogError` naming file and value."""


def _check_suffixes(reader: Reader) -> None:
    """Raise `TypeError` for suffixes that Blender could not be given: it would refuse the whole extension."""
    suffixes: object = reader.suffixes
    texts = isinstance(suffixes, list | tuple) and all(isinstance(suffix, str) for suffix in suffixes)
    if not texts or not all(suffix.startswith(".") and ";" not in suffix for suffix in reader.suffixes):
        raise TypeError(f"its suffixes are {short(suffixes)}, not texts such as ('.json',)")


READERS: Registry[Reader] = Registry(
    "a reader", "unisim_blender.logs", ("name", "layout", "suffixes", "recognises", "open"), _check_suffixes
)
"""The registered readers by their names: `readers.py` registers the package's own."""
register = READERS.register
SEARCH_DEPTH, SEARCHED_FOLDERS, LISTED_ENTRIES = 2, 500, 20_000
"""Bounds on the search for drives in a folder that is none: levels below it, folders looked at, entries listed of one."""
NAMED_DRIVES = 3
"""Largest number of drives that a message names."""


def _open_recorded(path: Path) -> Log:
    return open_log(path)


OWN: tuple[Reader, ...] = (
    BoxFileReader(_open_recorded),
    Argoverse2Reader(),
    KittiReader(),
    NcoreReader(),
    NuscenesReader(),
    PandasetReader(),
    WaymoReader(),
)
"""The package's own, in the order in which they are asked."""

for _reader in OWN:
    register(_reader)


def reader_of(path: Path) -> Reader | None:
    """Return the reader that recognises a folder or file; None where none does."""
    return next((reader for reader in READERS.with_plugins().values() if _recognises(reader, path)), None)


def suffixes() -> tuple[str, ...]:
    """Return the suffixes of files that can be dropped onto Blender's window to open the log that they belong to."""
    return tuple(dict.fromkeys(suffix for reader in READERS.with_plugins().values() for suffix in reader.suffixes))


def _recognises(reader: Reader, path: Path) -> bool:
    try:
        return reader.recognises(path)
    except Exception as error:  # noqa: BLE001  another package's code may raise anything
        warnings.warn(
            f"the reader {reader.name!r} fails at {path}: {type(error).__name__}: {in_a_line(error)}", stacklevel=3
        )
        return False


@memoized
def open_log(path: Path | str) -> Log:
    """Open the recorded drive at ``path``, or the one drive in that folder, with the reader that recognises it.

    Raises `LogError` where there is none that can be read, or several.
    """
    path = drive_in(Path(path))
    reader = reader_of(path)
    assert reader is not None
    try:
        log = reader.open(path)
    except TrajectoryError as error:
        raise LogError(f"{path}: {error}") from error
    check_times(path, log.drive)
    return log


def drive_in(path: Path) -> Path:
    """Return ``path`` where it is a recorded drive, else the one drive in that folder. Raises `LogError` that names the
    drives where it has several."""
    if not path.exists():
        raise LogError(f"{path}: there is no such log")
    drives = drives_in(path)
    if not drives:
        known = "; ".join(reader.layout for reader in READERS.with_plugins().values())
        raise LogError(f"{path}: is no recorded drive in a layout that is known ({known})")
    if len(drives) > 1:
        names = ", ".join(drive.relative_to(path).as_posix() for drive in drives[:NAMED_DRIVES])
        more = f" and {len(drives) - NAMED_DRIVES} more" if len(drives) > NAMED_DRIVES else ""
        raise LogError(f"{path}: has several recorded drives; choose one: {names}{more}")
    return drives[0]


def drives_in(path: Path) -> list[Path]:
    """Return the recorded drives in a folder, by name: itself where it is one, else those up to two levels below. Folders that
    `unisim render` wrote are none. Of a folder with very many entries only a part is searched."""
    return [path] if reader_of(path) is not None else folders_below(path, lambda folder: reader_of(folder) is not None)


def folders_below(path: Path, matches: Callable[[Path], object]) -> list[Path]:
    """Return the folders up to two levels below one that match, by name; neither what `unisim render` wrote nor what lies in
    it or in a match."""
    matching: list[Path] = []
    level, left = [path], SEARCHED_FOLDERS
    for _ in range(SEARCH_DEPTH):
        folders = [folder for parent in level for folder in _folders(parent)][:left]
        left -= len(folders)
        level = []
        for folder in folders:
            if (folder / "drive.json").is_file():  # rendered frames, which lie as PandaSet's do
                continue
            (matching if matches(folder) else level).append(folder)
    return sorted(matching)


def _folders(path: Path) -> list[Path]:
    """Return the folders in a folder that are not hidden, by name; none where it cannot be read."""
    try:
        with os.scandir(path) as entries:
            listed = islice(entries, LISTED_ENTRIES)
            return sorted(path / entry.name for entry in listed if entry.name[0] != "." and entry.is_dir())
    except OSError:
        return []


def drive_files(sizes: Mapping[str, int]) -> Collection[str]:
    """Return the names of the files of a log's folder that are read when it is opened, given all files' sizes in bytes; all of
    them where its reader does not say, by a method `drive_files` of its own with the same argument."""
    for reader in READERS.with_plugins().values():
        chosen = getattr(reader, "drive_files", None)
        names: Collection[str] | None = None if chosen is None else chosen(sizes)
        if names is not None:
            return names
    return sizes


DRIVE = FolderPart("drive", drive_files)
"""The part of a log that its drive is made of: of a log at a URL the rest is not fetched for a trained scene."""
