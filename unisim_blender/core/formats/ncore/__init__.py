"""NVIDIA's NCore V4 sequences: what recognises its logs and opens them."""

from __future__ import annotations

from pathlib import Path

from ...data.log import Log
from .layout import stores_beside


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
