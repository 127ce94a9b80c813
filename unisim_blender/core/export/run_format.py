"""What a format of a run is: one file or folder, written from the run's finished folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .finished_run import FinishedRun


@dataclass(frozen=True)
class RunFormat:
    """A format of a whole run, as --format has it.

    ``output`` is what it writes, below the run's folder. ``modules`` are imported before anything is rendered, so that a missing
    package is told at once. ``needs`` are the formats of frames that it is made of. ``write`` writes a run to a path: all of it,
    or nothing; equal runs give equal bytes. It raises `UnisimError`.
    """

    name: str
    about: str
    output: str
    modules: tuple[str, ...]
    needs: tuple[str, ...]
    write: Callable[[FinishedRun, Path], None]
