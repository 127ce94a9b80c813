"""KITTI's raw drives, tracking sequences and object frames: what recognises its logs and opens them."""

from __future__ import annotations

from pathlib import Path

from ...data.log import Log
from .layout import VELODYNE, tracking_sequence


class KittiReader:
    """Recognises and opens KITTI's raw drives and tracking sequences."""

    name = "kitti"
    layout = "KITTI: a raw drive's folder with velodyne_points/, or a tracking sequence's calib/0000.txt"
    suffixes: tuple[str, ...] = (".txt",)

    def recognises(self, path: Path) -> bool:
        """Whether a folder has velodyne_points/, or a path is one of a tracking sequence's."""
        return (path / VELODYNE).is_dir() or tracking_sequence(path) is not None

    def open(self, path: Path) -> Log:
        """Open the log. Raises `LogError`."""
        from .read import KittiLog

        return KittiLog(path)
