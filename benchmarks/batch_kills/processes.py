"""Processes that were started here: their descendants, and their end."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Sequence
from pathlib import Path

SAMPLED_EVERY_S = 0.5


def below(pid: int) -> dict[int, str]:
    """Titles of the processes that descend from one, by their ids."""
    found: dict[int, tuple[int, str]] = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            title = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
            found[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1]), title
        except OSError:
            continue
    inside, grown = {pid}, True
    while grown:
        more = {one for one, (parent, _) in found.items() if parent in inside} - inside
        inside, grown = inside | more, bool(more)
    return {one: title for one, (_, title) in found.items() if one in inside and one != pid}


class CpuMeter:
    """Measures within a ``with`` the processor time of running processes and those below them, twice a second: Ray does
    not wait for its workers, so what they took is not their parents'."""

    def __init__(self, roots: Sequence[subprocess.Popen[bytes]]) -> None:
        self._roots = roots
        self._first: dict[tuple[int, str], int] = {}
        self._last: dict[tuple[int, str], int] = {}
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    @property
    def seconds(self) -> float:
        """Processor time so far."""
        ticks = sum(last - self._first.get(key, 0) for key, last in self._last.items())
        return ticks / os.sysconf("SC_CLK_TCK")

    def __enter__(self) -> CpuMeter:
        self._first = self._sample()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()
        self._last |= self._sample()

    def _watch(self) -> None:
        while not self._done.wait(SAMPLED_EVERY_S):
            self._last |= self._sample()

    def _sample(self) -> dict[tuple[int, str], int]:
        """Ticks by the processes' ids and starts: ids are used again."""
        found = {}
        for pid in {pid for root in self._roots for pid in [root.pid, *below(root.pid)]}:
            try:
                fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            found[pid, fields[19]] = int(fields[11]) + int(fields[12])
        return found


def end(process: subprocess.Popen[bytes]) -> None:
    """Kill a process that was started here and those below it."""
    if process.poll() is not None:
        return
    for pid in [process.pid, *below(process.pid)]:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.wait()
