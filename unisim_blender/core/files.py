"""Files that appear under their name only when they are complete."""

from __future__ import annotations

import errno
import functools
import hashlib
import inspect
import json
import os
import shutil
import struct
import sys
import threading
import time
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import OutputError, UnisimError, in_a_line

PARTIAL_SUFFIX = ".partial"
Params = ParamSpec("Params")
ResultT = TypeVar("ResultT")


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


def write_file(path: Path, data: bytes | str, error: type[UnisimError] = OutputError) -> None:
    """Write all of ``data``, or nothing. A text, as UTF-8, has then reached the disk. Raises ``error``."""
    try:
        with partial_file(path) as temporary:
            temporary.write_bytes(data.encode() if isinstance(data, str) else data)
            if isinstance(data, str):
                with temporary.open("r+b") as file:
                    os.fsync(file.fileno())
    except OutputError as fault:
        raise error(str(fault)) from fault


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


def file_stamp(path: Path) -> tuple[int, int, int, int]:
    """Return what changes when a file's content does: inode, size, times of the last change of content and of state, ns.

    A copy that keeps the modification time still has a new change time (on Windows, that of creation).
    """
    about = path.stat()
    return about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns


FRESH_NS = 2_000_000_000
"""A file that changed this shortly before it was read can change again within one tick of the file system's clock."""


def content_digests(paths: Sequence[Path]) -> dict[Path, str]:
    """Return the SHA-256 of each file's content. Digests are cached among the user's files by `file_stamp`, so a file is
    read again only after it was written. Raises `OSError`."""
    folders = sorted({path.resolve().parent for path in paths})
    key = hashlib.sha256("\0".join(map(str, folders)).encode()).hexdigest()[:32]
    store = cache_folder() / "digests" / f"{key}.json"
    try:
        cached = {name: (tuple(stamp), digest) for name, (stamp, digest) in json.loads(store.read_bytes()).items()}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        cached = {}
    digests, current = {}, {}
    for path in paths:
        name, now_ns, stamp = str(path.resolve()), time.time_ns(), file_stamp(path)
        known = cached.get(name)
        digests[path] = known[1] if known is not None and known[0] == stamp else sha256_of_file(path)
        if now_ns - max(stamp[2:]) > FRESH_NS:
            current[name] = (stamp, digests[path])
    if current != cached:
        write_cached(store, json.dumps(current).encode())
    return digests


def write_cached(path: Path, data: bytes) -> None:
    """Write a file of the cache, or leave it: one that cannot be written costs time and nothing else."""
    with suppress(OutputError):
        write_file(path, data)


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Hold an output folder for this process while files are written into it; it is made if it is not there.

    The lock is the system's (`flock` of the folder; on Windows of a file beside it), so it ends with the process however
    that ends. This process may hold a folder several times. A file system that has no locks is not held. A folder that
    was made and is still empty at the end is removed. Raises `OutputError` where another process holds the folder.
    """
    is_new = False
    try:
        is_new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        lock = _Lock.of(folder)
    except FileExistsError as error:
        raise OutputError(f"{folder}: cannot be written: it is a file") from error
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error
    if lock is None:
        raise OutputError(f"{folder}: another process is writing into this folder; name another one, or wait for it")
    try:
        yield
    finally:
        lock.release()
        if is_new:
            with suppress(OSError):
                folder.rmdir()


def holds_out(function: Callable[Params, ResultT]) -> Callable[Params, ResultT]:
    """Decorate a function with a parameter ``out``, a folder: it is held (`hold_folder`) while the function runs."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def wrapper(*args: Params.args, **options: Params.kwargs) -> ResultT:
        with hold_folder(signature.bind(*args, **options).arguments["out"]):
            return function(*args, **options)

    return wrapper


class _Lock:
    """A lock of a folder that this process holds ``count`` times."""

    locks: ClassVar[dict[tuple[int, int], _Lock]] = {}
    guard: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, key: tuple[int, int], descriptor: int) -> None:
        self.key, self.descriptor, self.count, self.process = key, descriptor, 1, os.getpid()

    @classmethod
    def of(cls, folder: Path) -> _Lock | None:
        """Lock a folder; None where another process has. Raises `OSError`."""
        with cls.guard:
            about = folder.stat()
            key = about.st_dev, about.st_ino
            own = cls.locks.get(key)
            if own is not None and own.process == os.getpid():
                own.count += 1
                return own
            if sys.platform == "win32":
                descriptor = os.open(folder.with_name(f".{folder.name}.lock"), os.O_RDWR | os.O_CREAT)
            else:
                descriptor = os.open(folder, os.O_RDONLY)
            try:
                # a folder that was renamed or replaced in between is another one
                free = _locked(descriptor) and os.path.samestat(folder.stat(), about)
            except OSError:
                free = False
            if not free:
                os.close(descriptor)
                return None
            cls.locks[key] = lock = cls(key, descriptor)
            return lock

    def release(self) -> None:
        """Give the lock back once."""
        with self.guard:
            self.count -= 1
            if self.count == 0:
                os.close(self.descriptor)
                del self.locks[self.key]


def _locked(descriptor: int) -> bool:
    """Lock an open file or folder; False where another process has, True where the file system knows no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK)
    return True


BROKEN_ARRAYS = (
    OSError, ValueError, EOFError, KeyError, NotImplementedError, RuntimeError, MemoryError, TypeError, OverflowError,
    zipfile.BadZipFile, zlib.error, struct.error, SyntaxError, tokenize.TokenError,
)  # fmt: skip
"""Exceptions that zip files and numpy raise where a file of arrays is broken."""


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
