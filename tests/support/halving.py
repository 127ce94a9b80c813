"""Work for executors whose workers import it: halves of even numbers."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from unisim_blender.core.errors import UnisimError


@dataclass(frozen=True)
class Halves:
    """Makes a function that halves even numbers: the half, how many threads numpy's library has, and the process. At 4 its
    process is ended once, at 6 always."""

    folder: Path

    def __call__(self) -> Callable[[int], tuple[int, str | None, int]]:
        return self.halve

    def halve(self, number: int) -> tuple[int, str | None, int]:
        if number % 2:
            raise UnisimError(f"{number} is odd")
        if number == 6 or (number == 4 and not (self.folder / "ended").exists()):
            (self.folder / "ended").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return number // 2, os.environ.get("OPENBLAS_NUM_THREADS"), os.getpid()
