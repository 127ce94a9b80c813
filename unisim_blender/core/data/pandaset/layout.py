"""PandaSet's layout as the registry of readers knows it."""

from __future__ import annotations

from pathlib import Path

from ..log import Log
from ..reader import register


class PandasetReader:
    """Recognises and opens logs in PandaSet's layout."""

    name = "pandaset"
    layout = "PandaSet: a folder with lidar/ and camera/"
    suffixes: tuple[str, ...] = (".json",)

    def recognises(self, path: Path) -> bool:
        """Whether a folder has lidar/ and another of the layout's folders."""
        return (path / "lidar").is_dir() and any((path / name).is_dir() for name in ("camera", "annotations", "meta"))

    def open(self, path: Path) -> Log:
        """Open the log in a folder. Raises `LogError`."""
        from .reader import PandasetLog

        return PandasetLog(path)


register(PandasetReader())
