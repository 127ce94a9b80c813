"""KITTI's raw drives, tracking sequences and object frames: their folders, what recognises its logs and opens them."""

from __future__ import annotations

from pathlib import Path

from ...data.log import Log


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


VELODYNE = "velodyne_points"
SEQUENCE_FOLDERS = ("velodyne", "image_02", "image_03", "oxts", "calib", "label_02")
"""Of a tracking split: what the folders and files named after a sequence lie in."""


def tracking_sequence(path: Path) -> tuple[Path, str] | None:
    """Return the split's folder and the sequence's name that a path belongs to; None where it belongs to none.

    The path is the sequence's calib/0004.txt, or any other folder or file of it: velodyne/0004, label_02/0004.txt.
    """
    name = path.stem if path.suffix == ".txt" else path.name
    if path.parent.name not in SEQUENCE_FOLDERS or len(name) != 4 or not (name.isascii() and name.isdigit()):
        return None
    split = path.parent.parent
    return (split, name) if (split / "calib" / f"{name}.txt").is_file() else None


def beside_tracking(split: Path, sequence: str) -> Path:
    """Return the folder with what a tracking sequence that this program wrote says beside the layout: a raw drive's timestamps,
    and `meta/unisim.json`. A sequence of the dataset's own has none."""
    return split / "unisim" / sequence
