"""All writers of logs: the package's own, which their modules register, and those of other packages by their entry points.

Another of the package's own is a module or package beside `pandaset` and a line here. Another distribution registers a writer in
its pyproject.toml:

    [project.entry-points."unisim_blender.log_writers"]
    name = "module:writer"
"""

from __future__ import annotations

from functools import cache

from ..errors import UnisimError
from ..plugins import load_installed
from .argoverse2 import Argoverse2LogWriter as Argoverse2LogWriter
from .kitti.objects import KittiObjectWriter as KittiObjectWriter
from .kitti.tracking import KittiTrackingWriter as KittiTrackingWriter
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
    return load_installed(GROUP, "writer", WRITERS, ("name", "about", "version", "plan"))
