"""Readers of recorded drives, one a dataset, and `open_log`, which picks among them."""

from __future__ import annotations

from pathlib import Path

from ..errors import LogError
from ..geometry import TrajectoryError
from ..kept_results import read_once
from .log import Log
from .readers import all_readers, reader_of


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
        known = "; ".join(reader.layout for reader in all_readers())
        raise LogError(f"{path}: is no recorded drive in a layout that is known ({known})")
    try:
        return reader.open(path)
    except TrajectoryError as error:
        raise LogError(f"{path}: {error}") from error
