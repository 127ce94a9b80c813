"""Readers of recorded drives, one a dataset."""

from __future__ import annotations

from pathlib import Path

from ..errors import LogError
from ..geometry import TrajectoryError
from .log import Log


def is_pandaset(path: Path) -> bool:
    """Whether a folder has PandaSet's layout."""
    return (path / "lidar").is_dir() and any((path / name).is_dir() for name in ("camera", "annotations", "meta"))


def open_log(path: Path | str) -> Log:
    """The recorded drive at ``path``; LogError where there is none that can be read."""
    path = Path(path)
    if not path.exists():
        raise LogError(f"{path}: there is no such log")
    if is_pandaset(path):
        from .pandaset.reader import PandasetLog

        try:
            return PandasetLog(path)
        except TrajectoryError as error:
            raise LogError(f"{path}: {error}") from error
    raise LogError(f"{path}: is no recorded drive in a layout that is known (PandaSet: a folder with lidar/ and camera/)")
