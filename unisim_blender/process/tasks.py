"""Long work in processes of its own: sequences and trainings, run by the command line `unisim` itself.

What such a process has done is read off its folder, so a progress bar survives Blender, and a run that was cancelled
goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Container, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.sequence.records import finished_moments
from ..core.world.captures import CaptureKey
from ..editing.texts import clock_text, translatable
from ..translations import message
from . import interpreters

REMEDY = "Remedy: "
"""Begin of the line in which the command line says what mends its error."""
STOP_TIMEOUT_S = 20.0
"""Time limit for a process that was asked to end, after which it is killed."""


@dataclass
class Task:
    """A command that runs. ``arguments`` follow `unisim`; ``total`` is how much there is to do, in frames or minutes.

    It belongs to a ``file``, the .blend that it was started from, "" where that was not saved, which was the file number
    ``opening`` that this Blender opened; and to a ``scene`` of it, whose number in this Blender is ``scene_uid``.
    ``line`` and ``fraction_shown`` are what the window says of its progress."""

    arguments: list[str]
    folder: Path
    total: float
    chosen: str = ""
    file: str = ""
    opening: int = 0
    scene: str = ""
    scene_uid: int = 0
    line: str = ""
    fraction_shown: float = 0.0
    started_s: float = field(default_factory=time.monotonic)
    process: subprocess.Popen[bytes] | None = None
    code: int | None = None
    cancelled: bool = False
    words: deque[str] = field(default_factory=lambda: deque(maxlen=20))
    before: float = 0.0

    title = translatable("Task")
    """Name of what runs."""
    of_scene = True
    """Whether it belongs to one scene of its file, not to all."""
    trains = False
    """Whether it takes an interpreter that can train."""
    hears = False
    """Whether it takes the JSON objects that the command prints, a line each, by `hear`."""
    entry = "cli"
    """What of `bootstrap.py` it runs."""
    niceness = 0
    """Of its process, which has one thread where that is not 0."""
    units = translatable("{done} of {total} frames")
    rates = ""
    """Amount done of the total in words, and speed."""

    def start(self) -> None:
        """Begin; returns at once."""
        self.before = self.done
        threading.Thread(target=self._run, daemon=True).start()

    @property
    def running(self) -> bool:
        """Whether it goes on."""
        return self.code is None

    @property
    def done(self) -> float:
        """Amount that is done, of `total`."""
        raise NotImplementedError

    @property
    def fraction(self) -> float:
        """Fraction that is done, from 0 to 1."""
        return min(1.0, self.done / max(self.total, 1e-9))

    @property
    def problem(self) -> str:
        """Why it failed; "" where it did not."""
        if self.running or self.code == 0 or self.cancelled:
            return ""
        lines = [line for line in self.words if line.strip() and not line.startswith(REMEDY)]
        own = [line.removeprefix("Error: ") for line in lines if line.startswith("Error: ")]
        return (own or lines or [message("exit status {code}", code=self.code)])[-1]

    @property
    def remedy(self) -> str:
        """What mends the problem, as `UnisimError` names it; "" where nothing does."""
        return next((line.removeprefix(REMEDY) for line in self.words if line.startswith(REMEDY)), "")

    def finish(self) -> None:
        """Called in Blender's main thread once it has ended."""

    def text(self) -> str:
        """One line for a status bar."""
        if self.problem:
            return self.problem
        if self.cancelled and self.running:  # what it is at is finished yet
            return message("Stopping: {progress}", progress=self.measure())
        if self.cancelled:
            return message("Stopped at {progress}; start it again to resume", progress=self.measure())
        if not self.running:
            return message("Done: {progress}", progress=self.measure())
        spent, new = time.monotonic() - self.started_s, self.done - self.before
        if new <= 0:
            return message("{progress}, starting", progress=self.measure())
        left = clock_text((self.total - self.done) * spent / new)
        return message("{progress}, {time} left", progress=self.measure() + self.speed(new / spent), time=left)

    def measure(self) -> str:
        """Progress in words."""
        return message(self.units, done=int(self.done), total=int(self.total))

    def speed(self, rate: float) -> str:
        """Speed in words, or ""."""
        return message(self.rates, rate=rate) if self.rates else ""

    def cancel(self) -> None:
        """Ask it to end; what is finished stays."""
        self.cancelled = True
        process = self.process
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGTERM if sys.platform == "win32" else signal.SIGINT)
            threading.Thread(target=_end, args=(process,), daemon=True).start()

    def hear(self, event: dict[str, Any]) -> None:
        """Take an object that the command printed."""

    def _hear(self, lines: Iterable[bytes] | None) -> None:
        for line in lines or ():
            with suppress(ValueError):  # cut off where the process was ended
                self.hear(json.loads(line))

    def _run(self) -> None:
        """Do all of it, and then set the exit code."""
        try:
            code = self._do()
        except OSError as fault:
            self.words.append(str(fault))
            code = 1
        self.code = code

    def _do(self) -> int:
        """Run what there is to run to its end. Return the exit code. Raises OSError."""
        return self._call(self.arguments)

    def _call(self, arguments: list[str]) -> int:
        """Run one command of `unisim` to its end. Return its exit code. Raises OSError."""
        python, failed = interpreters.find(self.chosen, self.trains)
        if python is None:
            self.words += (interpreters.how_to_mend(failed, self.trains), f"{REMEDY}interpreter")
            return 1
        return self._execute(interpreters.command(python.path, self.entry, *arguments))

    def _execute(self, command: list[str]) -> int:
        """Run a command line to its end. Return its exit code. Raises OSError."""
        out = subprocess.PIPE if self.hears else subprocess.DEVNULL
        settings = {**os.environ, **({"OMP_NUM_THREADS": "1"} if self.niceness else {})}
        self.process = process = subprocess.Popen(command, stdout=out, stderr=subprocess.PIPE, env=settings)
        if self.niceness and hasattr(os, "setpriority"):
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, process.pid, self.niceness)
        if self.cancelled:
            process.kill()
        assert process.stderr is not None
        hearing = threading.Thread(target=self._hear, args=(process.stdout,), daemon=True)
        hearing.start()
        for line in process.stderr:
            self.words.append(line.decode(errors="replace").rstrip())
        hearing.join()
        return process.wait()


def _end(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()


class ShareTask(Task):
    """A command that says, in objects with a ``share`` from 0 to 1, how much is done."""

    hears = True
    units = translatable("{done} of {total} %")
    share = 0.0

    @property
    def done(self) -> float:
        return 100.0 * self.share

    def hear(self, event: dict[str, Any]) -> None:
        self.share = float(event.get("share", self.share))


class SequenceTask(Task):
    """Frames rendered into a folder."""

    title = translatable("Sequence")
    rates = translatable(", {rate:.2f} frames/s")
    wanted: Container[CaptureKey] | None = None
    """The frames and times that count; None: all in the folder."""

    @property
    def done(self) -> float:
        return float(finished_moments(self.folder, self.wanted))

    def newest(self) -> Path | None:
        return newest_image(self.folder)


def newest_image(folder: Path) -> Path | None:
    """Return the image that was finished last in the folder of a sequence; None where there is none."""
    try:
        return max((folder / "camera").glob("*/*.png"), key=lambda path: path.stat().st_mtime_ns, default=None)
    except OSError:  # one was replaced just now: the next look finds it
        return None


class TrainingTask(Task):
    """A scene that is trained."""

    title = translatable("Training")
    of_scene = False
    trains = True

    def curve(self) -> list[dict[str, float]]:
        """Return the entries that the training has written so far, one every hundred steps."""
        try:
            lines = (self.folder / "training.jsonl").read_text().splitlines()
            return [json.loads(line) for line in lines if line.endswith("}")]
        except OSError:
            return []

    @property
    def done(self) -> float:
        """Minutes of training."""
        curve = self.curve()
        return curve[-1]["seconds"] / 60 if curve else 0.0

    def measure(self) -> str:
        curve = self.curve()
        now = f", PSNR {curve[-1]['psnr']:.1f} dB, LiDAR {100 * curve[-1]['lidar_m']:.1f} cm" if curve else ""
        return message("{done:.1f} of {total:.1f} minutes", done=self.done, total=self.total) + now
