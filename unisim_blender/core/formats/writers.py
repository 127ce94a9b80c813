"""All writers of logs: the package's own, and those of other packages by their entry points.

Another of the package's own is a module `write` in its format's package, and a line in `OWN`. Another distribution registers
a writer in its pyproject.toml:

    [project.entry-points."unisim_blender.log_writers"]
    name = "module:writer"
"""

from __future__ import annotations

from ..errors import UnisimError
from .argoverse2.write import Argoverse2LogWriter
from .common.writer import WRITERS as WRITERS
from .common.writer import LogWriter, register
from .kitti.write.labels import KittiObjectWriter, KittiTrackingWriter
from .kitti.write.recording import KittiLogWriter
from .ncore.convert import NcoreLogWriter
from .nuscenes.write import NuscenesLogWriter
from .pandaset.write import PandasetLogWriter

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


def writer_named(name: str) -> LogWriter:
    """Return a writer. Raises `UnisimError` where there is none of that name."""
    writers = WRITERS.with_plugins()
    if name not in writers:
        raise UnisimError(f"there is no writer {name!r}, but {', '.join(writers)}")
    return writers[name]
