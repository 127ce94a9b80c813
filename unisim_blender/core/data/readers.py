"""All readers: the package's own, which their modules register, and those of other packages by their entry points.

The package's own have no entry points, because these need the metadata of an installed distribution, which the package
lacks where it is run from its sources or as Blender's extension. Another of its own is a package beside `pandaset` and
a line here. Another distribution registers a reader in its pyproject.toml:

    [project.entry-points."unisim_blender.logs"]
    name = "module:reader"
"""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path

from ..errors import in_a_line, short
from ..plugins import load_installed
from .argoverse2.layout import Argoverse2Reader as Argoverse2Reader
from .kitti.layout import KittiReader as KittiReader
from .ncore.layout import NcoreReader as NcoreReader
from .nuscenes.layout import NuscenesReader as NuscenesReader
from .pandaset.layout import PandasetReader as PandasetReader
from .reader import READERS as READERS
from .reader import Reader
from .waymo.layout import WaymoReader as WaymoReader

GROUP = "unisim_blender.logs"


def all_readers() -> tuple[Reader, ...]:
    """Return the readers there are, the package's own first."""
    return (*READERS.values(), *installed())


@cache
def installed() -> tuple[Reader, ...]:
    """Return the readers of other packages. Those that cannot be loaded are left out, with a warning each."""
    members = ("name", "layout", "suffixes", "recognises", "open")
    return load_installed(GROUP, "reader", READERS, members, _check_suffixes)


def _check_suffixes(reader: Reader) -> None:
    """Raise `TypeError` for suffixes that Blender could not be given: it would refuse the whole extension."""
    found: object = reader.suffixes
    texts = isinstance(found, list | tuple) and all(isinstance(one, str) for one in found)
    if not texts or not all(one.startswith(".") and ";" not in one for one in reader.suffixes):
        raise TypeError(f"its suffixes are {short(found)}, not texts such as ('.json',)")


def reader_of(path: Path) -> Reader | None:
    """Return the reader that recognises a folder or file; None where none does."""
    return next((reader for reader in all_readers() if _recognises(reader, path)), None)


def suffixes() -> tuple[str, ...]:
    """Return the suffixes of files that can be dropped onto Blender's window to open the log that they belong to."""
    return tuple(dict.fromkeys(suffix for reader in all_readers() for suffix in reader.suffixes))


def _recognises(reader: Reader, path: Path) -> bool:
    try:
        return reader.recognises(path)
    except Exception as error:  # noqa: BLE001  another package's code may raise anything
        warnings.warn(
            f"the reader {reader.name!r} fails at {path}: {type(error).__name__}: {in_a_line(error)}", stacklevel=3
        )
        return False
