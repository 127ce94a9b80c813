"""Interface of a writer of logs: it plans the files of a log in one dataset's layout, part by part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ...data.log import Log
from ...registry import Registry

SCRATCH = ".parts"
"""A folder below the log's for what parts leave for `WritePlan.finish`; it is removed at the end."""
Tick = Callable[[], None]
"""Called after each capture of a part."""


@dataclass(frozen=True)
class WriterPart:
    """Files that are written together, of one capture or of one sensor's ``captures``.

    ``files`` are paths below the folder, as posix. The part is complete when all are there, so ``write`` puts each
    under its name at once (`files.write_file`), and its bytes depend on the log alone: a part that is there is never
    written again.
    """

    files: tuple[str, ...]
    write: Callable[[Tick], None]
    captures: int = 1


@dataclass(frozen=True)
class WritePlan:
    """``losses``: a sentence for each thing of this log that the layout cannot say. ``finish`` writes, when all parts
    are there, what makes them a log: poses, calibration, labels; from the drive and the parts' files alone. ``opens``:
    the folder or file, below the whole, that `open_log` opens; "" is the whole."""

    losses: tuple[str, ...]
    parts: Sequence[WriterPart]
    finish: Callable[[], None]
    opens: str = ""


class LogWriter(Protocol):
    """A dataset's layout that is written. An instance, or a class whose methods are static."""

    name: str
    """One word, unique among writers, as --to has it: "kitti"."""
    about: str
    """Layout that it writes, for the command's help: "KITTI's raw layout, one camera rig and one LiDAR"."""
    version: int
    """Version of the files, raised when the same log gives other files: what an older program began is not
    continued."""

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan a log in the folder ``path``, which need not be there yet; nothing of images and sweeps is read before a
        part is written. Raises `OutputError` for a drive that the layout has no place for."""


WRITERS: Registry[LogWriter] = Registry("a writer", "unisim_blender.log_writers", ("name", "about", "version", "plan"))
"""The registered writers by their names: `writers.py` registers the package's own."""
register = WRITERS.register
