"""Readers of recorded drives, one a dataset, and `open_log`, which picks among them."""

from __future__ import annotations

from pathlib import Path

from ..errors import LogError
from ..geometry import TrajectoryError
from ..kept_results import read_once
from .log import Log
from .readers import all_readers, reader_of
from .values import check_times

LOOKED_INTO = 100
"""So many folders in one that is no log are looked at for logs."""


@read_once
def open_log(path: Path | str) -> Log:
    """Open the recorded drive at ``path`` with the reader that recognises it.

    Raises `LogError` where there is none that can be read.
    """
    path = Path(path)
    if not path.exists():
        raise LogError(f"{path}: there is no such log")
    reader = reader_of(path)
    if reader is None:
        inside = next((one for one in _folders(path) if reader_of(one) is not None), None)
        if inside is not None:
            raise LogError(f"{path}: is no recorded drive itself; name one of those in it, as {inside}")
        known = "; ".join(reader.layout for reader in all_readers())
        raise LogError(f"{path}: is no recorded drive in a layout that is known ({known})")
    try:
        log = reader.open(path)
    except TrajectoryError as error:
        raise LogError(f"{path}: {error}") from error
    check_times(path, log.drive)
    return log


def _folders(path: Path) -> list[Path]:
    """Some folders in a folder, by name."""
    try:
        return sorted(one for one in path.iterdir() if one.is_dir())[:LOOKED_INTO] if path.is_dir() else []
    except OSError:
        return []
