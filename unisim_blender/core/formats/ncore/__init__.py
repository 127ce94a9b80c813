"""NVIDIA's NCore V4 sequences: which files are its stores, what recognises its logs and opens them."""

from __future__ import annotations

from pathlib import Path

from ...data.log import Log


class NcoreReader:
    """Recognises and opens sequences of NCore V4."""

    name = "ncore"
    layout = "NCore V4: a folder with NAME.ncore4.zarr.itar, one such store, or the sequence's NAME.json beside it"
    suffixes: tuple[str, ...] = (".json", ".itar")

    def recognises(self, path: Path) -> bool:
        """Whether a folder holds stores, a file is a store, or a JSON file lies beside stores of its name."""
        return bool(stores_beside(path))

    def open(self, path: Path) -> Log:
        """Open the sequence. Raises `LogError`, or ModuleNotFoundError where `nvidia-ncore` is not installed."""
        from .read import NcoreLog

        return NcoreLog(path)


MARK = ".ncore4"
"""Middle part of the names of all stores of a sequence: NAME.ncore4.zarr.itar, NAME.ncore4-GROUP.zarr."""
ENDS = (".zarr.itar", ".zarr")


def is_store(path: Path) -> bool:
    """Return whether a path has the name of a store."""
    return MARK in path.name and path.name.endswith(ENDS)


def stores_beside(path: Path) -> list[Path]:
    """Return the stores of the sequence that a path names, sorted: those in a folder, those of the same sequence as a store, or
    those that a sequence's JSON file is named for."""
    if is_store(path):
        folder, begin = path.parent, path.name.rpartition(MARK)[0] + MARK
    elif path.suffix == ".json":
        folder, begin = path.parent, path.stem + MARK
    elif path.is_dir():
        folder, begin = path, ""
    else:
        return []
    if not path.exists():
        return []
    return sorted(store for store in folder.iterdir() if is_store(store) and store.name.startswith(begin))
