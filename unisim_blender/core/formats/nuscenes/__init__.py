"""nuScenes v1.0: what recognises its logs and opens them."""

from __future__ import annotations

from pathlib import Path

from ...data.log import Log
from .layout import find_tables


class NuscenesReader:
    """Recognises and opens scenes of nuScenes."""

    name = "nuscenes"
    layout = "nuScenes: the dataset's folder with v1.0-*/sample_data.json, or of several scenes one's file in samples/"
    suffixes: tuple[str, ...] = (".bin",)

    def recognises(self, path: Path) -> bool:
        """Whether a folder has tables, or a file lies in samples/ or sweeps/ beside them."""
        return bool(find_tables(path)[1])

    def open(self, path: Path) -> Log:
        """Open the scene. Raises `LogError`."""
        from .read import NuscenesLog

        return NuscenesLog(path)
