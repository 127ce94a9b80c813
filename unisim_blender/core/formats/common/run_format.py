"""What a format of a run is: one file or folder, written from the run's messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ...json_file import Node
from ...world.drive import Drive
from .messages import ImageMessage, Message


class Run(Protocol):
    """A finished run that formats are written of; `export.finished_run.FinishedRun` is one.

    ``drive``: what was rendered, its cameras at the size of the images. ``shift_ns``: what is added to all times.
    """

    drive: Drive
    shift_ns: int

    def about(self) -> dict[str, str]:
        """Return what messages do not say, as texts by name."""
        ...

    def name_of(self, image: ImageMessage) -> str:
        """Return what an image is called in files that name it."""
        ...

    def messages(self) -> Iterator[Message]:
        """Yield everything in the order of time. Raises `LogError` and `OutputError` for files that are missing or broken."""
        ...

    def images(self) -> Iterator[tuple[ImageMessage, Node]]:
        """Yield all images in the order of time, each with its boxes' poses in its camera's frame, by actor. Raises as
        `messages`."""
        ...


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
    write: Callable[[Run, Path], None]
