"""Waymo Open's perception dataset, version 2: what recognises its logs and opens them.

A component of the dataset is a folder, a segment a file in each: ``vehicle_pose/SEGMENT.parquet``. A log is one segment: the
path of any of its files, or the folder above the components where it holds one segment alone.
"""

from __future__ import annotations

from pathlib import Path

from ...data.log import Log
from .segment import POSES, SUFFIX


class WaymoReader:
    """Recognises and opens segments of Waymo Open's perception dataset, version 2."""

    name = "waymo"
    layout = f"Waymo Open v2: a folder with {POSES}/, or a segment's {SUFFIX} file in it"
    suffixes: tuple[str, ...] = (SUFFIX,)

    def recognises(self, path: Path) -> bool:
        """Whether a folder has poses of segments, or a file is one of a segment that has poses."""
        if path.suffix == SUFFIX:
            return (path.parent.parent / POSES / path.name).is_file()
        return any((path / POSES).glob(f"*{SUFFIX}")) if (path / POSES).is_dir() else False

    def open(self, path: Path) -> Log:
        from .read import WaymoLog

        return WaymoLog(path)
