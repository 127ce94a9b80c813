"""Progress bars: redrawn in a terminal; into a file or a pipe a line now and then."""

from __future__ import annotations

import sys
import time
from typing import Any

from tqdm import tqdm

LINE_INTERVAL_S = 30.0
"""Seconds between two lines."""


class Bar(tqdm):  # type: ignore[misc]
    """`tqdm`, which where nobody sees it redrawn writes a line every EVERY_S seconds and one at the end."""

    def __init__(self, *args: Any, **options: Any) -> None:
        file = options.get("file") or sys.stderr
        self.in_lines = not file.isatty()
        self._said_at, self._said_n = time.monotonic(), 0.0
        self.disable: bool
        if self.in_lines:
            options["dynamic_ncols"] = False
            if options.get("bar_format"):
                options["bar_format"] = options["bar_format"].replace("|{bar}|", "")
            else:
                options["ncols"] = 0  # no bar
        super().__init__(*args, **options)

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Draw the bar, or write its line where one is due."""
        if not self.in_lines:
            return bool(super().display(msg, pos))
        due = time.monotonic() - self._said_at >= LINE_INTERVAL_S
        if due:
            self._say()
        return due

    def close(self) -> None:
        """Leave the bar, or write its last line."""
        if not self.in_lines:
            super().close()
        elif not self.disable:
            if self.n != self._said_n:
                self._say()
            self.disable = True
            self._decr_instances(self)

    def _say(self) -> None:
        self._said_at, self._said_n = time.monotonic(), self.n
        self.fp.write(f"{str(self).strip()}\n")
        self.fp.flush()
