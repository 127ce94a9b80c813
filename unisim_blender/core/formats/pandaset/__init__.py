"""PandaSet's layout, which rendered drives are written in, too: what recognises its logs and opens them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from ...data.image_files import SUFFIXES
from ...data.log import Log


class PandasetReader:
    """Recognises and opens logs in PandaSet's layout."""

    name = "pandaset"
    layout = "PandaSet: a folder with lidar/ and camera/"
    suffixes: tuple[str, ...] = (".json", ".pkl.gz", ".pkl")

    def recognises(self, path: Path) -> bool:
        """Whether a folder has lidar/ and another of the layout's folders."""
        return (path / "lidar").is_dir() and any((path / name).is_dir() for name in ("camera", "annotations", "meta"))

    def drive_files(self, sizes: Mapping[str, int]) -> Collection[str] | None:
        """Return what of a folder's files is read when it is opened: all but images, of which each camera's first tells their
        size, sweeps and their classes. None where it is no log in this layout.

        PandaSet's own do not say which LiDARs they have: the largest sweep does.
        """
        folders = {name.split("/")[0] for name in sizes}
        if "lidar" not in folders or not folders & {"camera", "annotations", "meta"}:
            return None
        parts: dict[str, list[str]] = {}
        for name in sorted(sizes):
            parts.setdefault(name.rpartition("/")[0], []).append(name)
        left_out: set[str] = set()
        for folder, names in parts.items():
            files = [name for name in names if name.lower().endswith((*SUFFIXES, ".pkl.gz", ".pkl"))]
            if folder.startswith("camera/"):
                left_out |= set(files[1:])
            elif folder == "lidar":
                own = "meta/unisim.json" not in sizes
                left_out |= set(files) - ({max(files, key=lambda name: sizes[name])} if own and files else set())
            elif folder == "annotations/semseg":
                left_out |= set(files)
        return sizes.keys() - left_out

    def open(self, path: Path) -> Log:
        from .read import PandasetLog

        return PandasetLog(path)
