"""Processes that were started here: their descendants, and their end."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterable
from pathlib import Path


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


def cpu_seconds(processes: Iterable[subprocess.Popen[bytes]]) -> float:
    """Processor time of running processes, of those below them, and of those of these that have ended."""
    ticks = 0
    for pid in {pid for process in processes for pid in [process.pid, *below(process.pid)]}:
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        ticks += sum(map(int, fields[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


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
