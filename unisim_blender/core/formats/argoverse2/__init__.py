"""Argoverse 2's sensor dataset: what recognises its logs and opens them."""

from __future__ import annotations

from pathlib import Path

from ...data.log import Log
from .files import POSES


class Argoverse2Reader:
    """Recognises and opens logs of Argoverse 2's sensor dataset."""

    name = "argoverse2"
    layout = f"Argoverse 2: a folder with {POSES}"
    suffixes: tuple[str, ...] = (".feather",)

    def recognises(self, path: Path) -> bool:
        """Whether a folder has the file of poses."""
        return (path / POSES).is_file()

    def open(self, path: Path) -> Log:
        """Open the log in a folder. Raises `LogError`."""
        from .read import Argoverse2Log

        return Argoverse2Log(path)
