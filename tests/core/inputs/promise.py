"""What every reader keeps to, whatever a file holds: it gives a valid value or raises `UnisimError` in one sentence
that names the file, within a time and an amount of memory; it leaves files as they were, and nothing of a
pickle is looked up."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import FrameType
from typing import Any

from hypothesis import event
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

import inputs.profiles  # noqa: F401 before any property is made
from inputs.strategies import Input
from unisim_blender.core.errors import UnisimError

LIMIT_S = 5.0
"""An input may take so much of a processor."""
MEMORY_BYTES = 1 << 30
"""So much more memory than before an input the process may take."""
MOST_LETTERS = 1000
"""Of a sentence, beside the path in it."""
PARTS = (".partial", ".making-", ".tmp")
"""In the names of files that are being written."""


class TooLongError(BaseException):
    """An input was not done within LIMIT_S; no reader's `except Exception` takes it for its own."""


@dataclass(frozen=True, eq=False)
class Reader:
    """``read`` reads the files of ``folder``, which are ``whole`` before faults; a refusal holds one of ``names``.

    ``keeps`` says that reading leaves files as they are; caches and records may be written again. ``refuses`` says that
    broken files are refused; those of caches count as missing.
    """

    folder: Path
    whole: Mapping[str, bytes]
    read: Callable[[], object]
    inputs: SearchStrategy[Input]
    names: tuple[str, ...]
    keeps: bool = True
    refuses: bool = True


class Property:
    """A reader that is made when it is first needed: ``make`` fills an empty folder."""

    def __init__(self, make: Callable[[Path], Reader]) -> None:
        self.make = make
        self.writes = 0
        self.changed: set[str] = set()

    @cached_property
    def reader(self) -> Reader:
        """The reader, which has read its files once while they were whole."""
        self._folder = tempfile.TemporaryDirectory(prefix="inputs-")
        reader = self.make(Path(self._folder.name))
        for file in reader.whole:
            self._write(reader, file, reader.whole[file])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read()
        return reader

    @property
    def inputs(self) -> SearchStrategy[Input]:
        """Inputs for `hypothesis.given`."""
        return st.deferred(lambda: self.reader.inputs)

    def check(self, changes: Input) -> None:
        """Read the files with faults, and check what the reader does."""
        reader = self.reader
        self._lay(reader, changes)
        before = snapshot(reader.folder)
        with warnings.catch_warnings(), nothing_is_looked_up():
            warnings.simplefilter("ignore")
            said = refusal(reader.read)
        event("read" if said is None else "refused")
        after = snapshot(reader.folder)
        if reader.keeps:
            assert after == before, f"files changed: {sorted(set(after.items()) ^ set(before.items()))[:3]}"
        assert not [name for name in after if any(part in name for part in PARTS)], "a file is half written"
        if said is not None:
            assert reader.refuses, f"is refused where it must count as missing: {said}"
            assert "\n" not in said, f"more than a line: {said!r}"
            assert len(said) <= MOST_LETTERS + len(str(reader.folder)), f"{len(said)} letters: {said[:200]!r}"
            assert any(name in said for name in reader.names), f"names no file: {said[:200]!r}"

    def _lay(self, reader: Reader, changes: Input) -> None:
        if not reader.keeps:
            for path in reader.folder.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            self.changed = set(reader.whole)
        for file in self.changed:
            self._write(reader, file, reader.whole[file])
        self.changed = {change.file for change in changes}
        content: dict[str, bytes | None] = {}
        for change in changes:
            now = content.get(change.file, reader.whole[change.file])
            content[change.file] = None if now is None or not change.view else change.applied(now)
        for file, data in content.items():
            self._write(reader, file, data)

    def _write(self, reader: Reader, file: str, data: bytes | None) -> None:
        path = reader.folder / file
        if data is None:
            path.unlink()
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        # file systems' clocks tick in milliseconds, and what was read is remembered by a file's time
        self.writes += 1
        os.utime(path, ns=(10**18 + self.writes * 1000, 10**18 + self.writes * 1000))


def snapshot(folder: Path) -> dict[str, tuple[int, int]]:
    """Return the sizes and times of all files below a folder."""
    found = {}
    for at, _, names in os.walk(folder):
        for name in names:
            state = os.stat(os.path.join(at, name))
            found[os.path.relpath(os.path.join(at, name), folder)] = state.st_size, state.st_mtime_ns
    return found


def refusal(read: Callable[[], object]) -> str | None:
    """Return the sentence with which ``read`` refuses, None where it reads. Any other exception is a
    failure, as is lateness."""
    begun = time.process_time()
    try:
        with bounded():
            read()
        said = None
    except UnisimError as error:
        said = str(error)
    except TooLongError:
        raise AssertionError(f"took more than {LIMIT_S:g} s of a processor") from None
    took = time.process_time() - begun
    assert took <= LIMIT_S, f"took {took:.1f} s of a processor"
    return said


def _ring(signum: int, frame: FrameType | None) -> None:
    raise TooLongError


@contextmanager
def bounded() -> Iterator[None]:
    """End what takes more than LIMIT_S of a processor with TooLongError, and more than MEMORY_BYTES
    with MemoryError."""
    import resource

    before, limits = signal.signal(signal.SIGPROF, _ring), resource.getrlimit(resource.RLIMIT_AS)
    sizes = Path("/proc/self/statm")
    if sizes.exists():
        taken = int(sizes.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY_BYTES, limits[1]))
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, limits)
        signal.signal(signal.SIGPROF, before)


FORBIDDEN = (
    "pickle.find_class",
    "os.system",
    "os.exec",
    "os.fork",
    "os.posix_spawn",
    "subprocess.Popen",
    "socket.connect",
)
"""What Python tells an audit hook of that no file may bring about."""
_heard: list[str] | None = None


def _listen(name: str, arguments: tuple[Any, ...]) -> None:
    if _heard is not None and name in FORBIDDEN:
        _heard.append(f"{name} {arguments[:2]}")


sys.addaudithook(_listen)


@contextmanager
def nothing_is_looked_up() -> Iterator[None]:
    """Fail where a class is looked up for a pickle, or a process or a connection is begun."""
    global _heard
    heard: list[str] = []
    _heard = heard
    try:
        yield
    finally:
        _heard = None
    assert not heard, heard
