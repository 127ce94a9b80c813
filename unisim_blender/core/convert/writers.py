"""All writers of logs: the package's own, which their modules register, and those of other packages by their entry points.

Another of the package's own is a module or package beside `pandaset` and a line here. Another distribution registers a writer in
its pyproject.toml:

    [project.entry-points."unisim_blender.log_writers"]
    name = "module:writer"
"""

from __future__ import annotations

import warnings
from functools import cache
from importlib.metadata import EntryPoint
from typing import cast

from ..errors import UnisimError, in_a_line
from ..plugins import entries
from .kitti.writer import KittiLogWriter as KittiLogWriter
from .ncore import NcoreLogWriter as NcoreLogWriter
from .nuscenes.writer import NuscenesLogWriter as NuscenesLogWriter
from .pandaset import PandasetLogWriter as PandasetLogWriter
from .writer import WRITERS as WRITERS
from .writer import LogWriter

GROUP = "unisim_blender.log_writers"


def all_writers() -> dict[str, LogWriter]:
    """Return the writers there are by their names, the package's own first."""
    return {**WRITERS, **{writer.name: writer for writer in installed()}}


def writer_named(name: str) -> LogWriter:
    """Return a writer. Raises `UnisimError` where there is none of that name."""
    writers = all_writers()
    if name not in writers:
        raise UnisimError(f"there is no writer {name!r}, but {', '.join(writers)}")
    return writers[name]


@cache
def installed() -> tuple[LogWriter, ...]:
    """Return the writers of other packages. Those that cannot be loaded are left out, with a warning each."""
    found: dict[str, LogWriter] = {}
    for entry in entries(GROUP):
        try:
            writer = _loaded(entry)
            if writer.name in WRITERS or writer.name in found:
                raise ValueError(f"there is a writer {writer.name!r} already")
        except Exception as error:  # noqa: BLE001  another package's code may raise anything, and the others still work
            about = f"{type(error).__name__}: {in_a_line(error)}"
            warnings.warn(f"the writer {entry.name!r} ({entry.value}) is left out: {about}", stacklevel=3)
        else:
            found[writer.name] = writer
    return tuple(found.values())


def _loaded(entry: EntryPoint) -> LogWriter:
    writer = entry.load()
    for name in ("name", "about", "version", "plan"):
        if not hasattr(writer, name):
            raise TypeError(f"{entry.value} has no {name!r}")
    return cast(LogWriter, writer)
