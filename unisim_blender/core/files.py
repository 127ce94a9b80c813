"""Files that appear under their name only when they are complete."""

from __future__ import annotations

import hashlib
import os
import shutil
import struct
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import OutputError, UnisimError, in_a_line

PARTIAL_SUFFIX = ".partial"


@contextmanager
def partial_file(path: Path) -> Iterator[Path]:
    """Give a temporary name beside ``path`` to write to, and rename it to ``path`` at the end.

    Where anything fails the temporary file goes and what ``path`` held before stays. Raises `OutputError` where the
    system cannot write (a full disk, no permission); OpenEXR reports those as RuntimeError.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}{PARTIAL_SUFFIX}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise OutputError(f"{path}: cannot be written: {reason}") from error
    finally:
        with suppress(NotADirectoryError):  # a folder of the path is a file: nothing was written
            temporary.unlink(missing_ok=True)


def write_file(path: Path, data: bytes) -> None:
    """Write all of ``data``, or nothing. Raises `OutputError`."""
    with partial_file(path) as temporary:
        temporary.write_bytes(data)


@contextmanager
def partial_folder(path: Path) -> Iterator[Path]:
    """Give a folder of the name of ``path`` to write to, which is not there yet, and put it in the place of ``path`` at the end.

    Where anything fails it goes and what ``path`` held before stays. Raises `OutputError` where the system cannot write.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}{PARTIAL_SUFFIX}")
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        yield temporary / path.name
        if path.is_dir():
            os.replace(path, temporary / "former")
        os.replace(temporary / path.name, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def remove_partial_files(folder: Path) -> None:
    """Remove the files and folders that a killed process left behind anywhere below ``folder``."""
    for path in list(folder.rglob(f".*{PARTIAL_SUFFIX}")):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def sha256_of_file(path: Path) -> str:
    """Hex digest of a file's bytes."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


BROKEN_ARRAYS = (
    OSError, ValueError, EOFError, KeyError, NotImplementedError, RuntimeError, MemoryError, TypeError, OverflowError,
    zipfile.BadZipFile, zlib.error, struct.error, SyntaxError, tokenize.TokenError,
)  # fmt: skip
"""What zip files and numpy raise where a file of arrays is broken."""


def read_arrays(path: Path, error: type[UnisimError], what: str = "is no file of arrays") -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file by name; nothing is unpickled. Raises ``error``, which says ``what``
    the file is not."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except BROKEN_ARRAYS as fault:
        raise error(f"{path}: {what}: {in_a_line(fault)}") from fault
    except AttributeError as fault:  # numpy read a single array, or a zip file's member that is none
        raise error(f"{path}: {what}") from fault


CACHE_VARIABLE = "UNISIM_CACHE"


def cache_folder() -> Path:
    """Where this user's files lie that can be made again at any time: UNISIM_CACHE, or the platform's own place."""
    if chosen := os.environ.get(CACHE_VARIABLE):
        return Path(chosen)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "unisim_blender"
