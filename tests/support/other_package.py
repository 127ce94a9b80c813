"""A distribution of somebody else's with a reader of logs, installed into a folder, and a log of its layout."""

from __future__ import annotations

import zipfile
from pathlib import Path

MODULE = '''
import zipfile
from pathlib import Path

from unisim_blender.core.formats.pandaset.read import PandasetLog


class ZippedPandaset:
    """A log in PandaSet's layout in one file, unpacked beside it."""

    name = "zipped"
    layout = "zipped PandaSet: a .zip with lidar/ and camera/"
    suffixes = (".zip",)

    @staticmethod
    def recognises(path):
        return path.suffix == ".zip" and path.is_file()

    @staticmethod
    def open(path):
        folder = path.with_suffix("")
        with zipfile.ZipFile(path) as file:
            file.extractall(folder)
        log = PandasetLog(folder)
        log.path = path
        return log


class Failing(ZippedPandaset):
    name = "failing"

    @staticmethod
    def recognises(path):
        raise RuntimeError("this reader is broken")


class Unsuffixed(ZippedPandaset):
    name = "unsuffixed"
    suffixes = "zip"


class Bare(ZippedPandaset):
    name = "bare"
    suffixes = ("zip",)


class Taken(ZippedPandaset):
    name = "pandaset"
'''


def install(folder: Path, entries: str) -> None:
    """Put a distribution with entry points into a folder, as pip does."""
    (folder / "zipped_pandaset.py").write_text(MODULE, encoding="utf-8")
    about = folder / "zipped_pandaset-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: zipped-pandaset\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text(f"[unisim_blender.logs]\n{entries}\n", encoding="utf-8")


def write_zipped(out: Path) -> Path:
    """Write the small log as one file, and beside it as the folder ``unpacked``; the file."""
    from small_log import write_small_log  # it needs the package under its own name, which Blender does not give it

    folder, path = out / "unpacked", out / "log.zip"
    write_small_log(folder)
    with zipfile.ZipFile(path, "w") as file:
        for one in sorted(folder.rglob("*")):
            file.write(one, one.relative_to(folder))
    return path
