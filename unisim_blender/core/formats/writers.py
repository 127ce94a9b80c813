"""All writers of logs: the package's own, and those of other packages by their entry points.

Another of the package's own is a module `write` in its format's package, and a line in `OWN`. Another distribution registers
a writer in its pyproject.toml:

    [project.entry-points."unisim_blender.log_writers"]
    name = "module:writer"
"""

from __future__ import annotations

from functools import cache

from ..errors import UnisimError
from ..plugins import load_installed
from .argoverse2.write import Argoverse2LogWriter
from .common.writer import WRITERS, LogWriter, register
from .kitti.write.objects import KittiObjectWriter
from .kitti.write.raw import KittiLogWriter
from .kitti.write.tracking import KittiTrackingWriter
from .ncore.convert import NcoreLogWriter
from .nuscenes.write import NuscenesLogWriter
from .pandaset.convert import PandasetLogWriter

GROUP = "unisim_blender.log_writers"

OWN: tuple[LogWriter, ...] = (
    Argoverse2LogWriter(),
    KittiObjectWriter(),
    KittiTrackingWriter(),
    KittiLogWriter(),
    NcoreLogWriter(),
    NuscenesLogWriter(),
    PandasetLogWriter(),
)
"""The package's own, in the order in which the command lists them."""

for _writer in OWN:
    register(_writer)


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
    return load_installed(GROUP, "writer", WRITERS, ("name", "about", "version", "plan"))
