"""How large the copies of inputs may become: those that were used longest ago go first, those that a process uses stay.

Beside the copies, `used/DIGEST.BYTES` is written at the time at which one was used last. `held/NAME` lists the digests
that a process has used; the process has it locked until it ends, so that a file that nobody has locked is of one that
ended. All of it changes under one lock. Where the system has no locks of files, nothing is removed.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import UnisimError
from ..files import cache_folder

HAS_LOCKS = os.name == "posix"
VARIABLE = "UNISIM_INPUTS_GB"
LIMIT_GB = 50.0
INPUTS = "inputs"
"""The folder of copies below that of caches."""


def limit_bytes() -> float:
    """Return how many bytes all copies may have: of the variable ``UNISIM_INPUTS_GB``, infinite for "inf". Raises
    `UnisimError` where it is no size."""
    text = os.environ.get(VARIABLE) or str(LIMIT_GB)
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value >= 0:
        raise UnisimError(f"{VARIABLE}: {text!r} is no size in GB, 0 or more, or inf")
    return value * 1e9


def hold(root: Path, digest: str, put: Callable[[], object] | None = None, size: int | None = None) -> bool:
    """Have a copy stay until this process ends, and note that it was used now; whether it is there. ``put`` puts it there
    first, with so many bytes fetched as ``size``. Raises `OSError`."""
    with _locked(root):
        if put is not None:
            put()
        if not HAS_LOCKS:
            return (root / "copies" / digest).is_dir()
        if not (root / "copies" / digest).is_dir():
            return False
        _InUse.of(root).add(digest)
        os.utime(_marker(root, digest, size))
    return True


def make_room(root: Path, needed: float) -> None:
    """Remove copies that no process uses, those that were used longest ago first, until this many bytes more lie within the
    limit, or none is left. Raises `UnisimError` where the limit is no size, and `OSError`."""
    most = limit_bytes()
    if not HAS_LOCKS or not (root / "copies").is_dir():
        return
    with _locked(root):
        for left in root.glob(".dropped-*"):  # by a process that was killed
            shutil.rmtree(left, ignore_errors=True)
        markers = [_marker(root, place.name) for place in (root / "copies").iterdir()]
        total = sum(map(_bytes, markers)) + needed
        if total <= most:
            return
        in_use, dropped = _digests_in_use(root), set[str]()
        for marker in sorted(markers, key=lambda one: one.stat().st_mtime_ns):
            digest = marker.stem
            if total <= most:
                break
            if digest not in in_use:
                _drop(root, digest)
                total -= _bytes(marker)
                marker.unlink()
                dropped.add(digest)
        _forget(root, dropped)


DIGEST = re.compile(r"\.?[0-9a-f]{24,}[.\w-]*")
"""How entries of caches are named; other files below the caches' folder are somebody else's."""


def cache_sizes() -> dict[str, int]:
    """Return the bytes of the user's caches by the names of their folders."""
    root = cache_folder()
    places = [place for place in root.iterdir() if place.is_dir()] if root.is_dir() else []
    entries = {place.name: [place] if place.name == INPUTS else _entries(place) for place in places}
    return {name: sum(map(_size, made)) for name, made in entries.items() if made}


def _entries(place: Path) -> list[Path]:
    return [entry for entry in place.iterdir() if DIGEST.fullmatch(entry.name)]


def _size(path: Path) -> int:
    return sum(map(_on_disk, path.rglob("*"))) if path.is_dir() else _on_disk(path)


def clear_cache() -> None:
    """Remove what lies in the user's caches, but for copies of inputs that a process uses and what is being written. Raises
    `UnisimError`, and `OSError`."""
    for name in cache_sizes():
        place = cache_folder() / name
        if name == INPUTS:
            make_room(place, math.inf)
            continue
        for entry in _entries(place):
            if entry.name.startswith(".") or entry.suffix == ".partial":
                continue
            if entry.is_dir():
                shutil.rmtree(entry, ignore_errors=True)
            else:
                with suppress(OSError):
                    entry.unlink()


def _bytes(marker: Path) -> int:
    return int(marker.suffix[1:])


def _marker(root: Path, digest: str, size: int | None = None) -> Path:
    """Return the file that says how large a copy is; it is written where there is none, as old as the copy. None: of the
    size that its files take."""
    with suppress(StopIteration):
        return next((root / "used").glob(f"{digest}.*"))
    place = root / "copies" / digest
    if size is None:
        size = sum(_on_disk(path) for path in place.rglob("*"))
    marker = root / "used" / f"{digest}.{size}"
    marker.parent.mkdir(exist_ok=True)
    marker.touch()
    when = place.stat().st_mtime
    os.utime(marker, (when, when))
    return marker


def _on_disk(path: Path) -> int:
    """Return what a file takes: of parts that were not fetched, nothing."""
    about = path.lstat()
    return min(about.st_size, about.st_blocks * 512) if path.is_file() else 0


def _drop(root: Path, digest: str) -> None:
    """Remove a copy: it is whole under its name, or not there."""
    away = Path(tempfile.mkdtemp(prefix=".dropped-", dir=root))
    (root / "copies" / digest).rename(away / digest)
    shutil.rmtree(away, ignore_errors=True)


def _forget(root: Path, digests: set[str]) -> None:
    """Remove what is known of copies that are gone."""
    for known in (root / "known").glob("*.json"):
        try:
            if json.loads(known.read_bytes())["digest"] in digests:
                known.unlink()
        except (OSError, ValueError, KeyError, TypeError):
            continue


def _digests_in_use(root: Path) -> set[str]:
    """Return the digests of the copies that processes use; what those that ended left is removed."""
    import fcntl

    in_use: set[str] = set()
    for path in (root / "held").glob("*"):
        with path.open("rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                in_use |= set(file.read().decode().split())
            else:
                path.unlink()
    return in_use


@dataclass
class _InUse:
    """The copies below a root that this process has used. The open file is locked."""

    path: Path
    descriptor: int
    digests: set[str] = field(default_factory=set)

    @staticmethod
    def of(root: Path) -> _InUse:
        """Return this process's; under the lock. Raises `OSError`."""
        import fcntl

        own = _all_in_use.get(root)
        if own is None or not own.path.exists():  # who empties the cache empties this, too
            (root / "held").mkdir(exist_ok=True)
            descriptor, name = tempfile.mkstemp(prefix=f"{os.getpid()}-", dir=root / "held")
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            own = _all_in_use[root] = _InUse(Path(name), descriptor)
        return own

    def add(self, digest: str) -> None:
        if digest not in self.digests:
            os.write(self.descriptor, f"{digest}\n".encode())
            self.digests.add(digest)


_all_in_use: dict[Path, _InUse] = {}


@contextmanager
def _locked(root: Path) -> Iterator[None]:
    """Have one process at a time change what is below a root, where the system has locks of files."""
    if not HAS_LOCKS:
        yield
        return
    import fcntl

    root.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(root / "lock", os.O_RDWR | os.O_CREAT, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
