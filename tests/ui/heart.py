"""For how long the window did nothing else, without what the test itself does, and what it did meanwhile."""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import wraps
from types import FrameType
from typing import ParamSpec, TypeVar

BEAT_S = 0.005
LOOK_S = 0.01
"""Between two looks at what the window does."""
LATE_S = 0.05
"""A beat that is so late is looked into."""
LONG_S = 0.25
"""A block that is so long is noted with what the window did in it."""
OURS = "unisim_blender"
"""Part of the path of the extension's files."""
P = ParamSpec("P")
R = TypeVar("R")


class Heart:
    """Measures for how long the window did nothing else at most, in seconds.

    ``within`` says what it did in the longest block: by function of the extension that ran, "Blender" where no Python
    ran, or "test", in how many looks it was found.
    """

    def __init__(self) -> None:
        self.last = time.monotonic()
        self.longest = 0.0
        self.within: Counter[str] = Counter()
        self.looks: Counter[str] = Counter()
        self.blocks: list[tuple[float, dict[str, int]]] = []
        """All blocks of `LONG_S` and longer, in seconds, each with its looks as in ``within``."""
        self.apart = 0
        """How many functions of the test's own are at work, one in the other."""

    def beat(self) -> float:
        """Called by a timer of Blender's."""
        now = time.monotonic()
        block_s = now - self.last - BEAT_S
        looks, self.looks = Counter(dict(self.looks)), Counter()  # a copy: the other thread may still add to the first
        if block_s > LONG_S:
            self.blocks.append((round(block_s, 2), dict(looks.most_common(4))))
        if block_s > self.longest:
            self.longest, self.within = block_s, looks
        self.last = now
        return BEAT_S

    def begin(self) -> None:
        """Forget what was measured."""
        self.longest, self.last = 0.0, time.monotonic()
        self.within, self.looks, self.blocks = Counter(), Counter(), []

    def look(self, main: int) -> None:
        """Look at what the thread ``main`` does, where the beat is late."""
        if time.monotonic() - self.last > LATE_S and not self.apart:
            self.looks[what_runs(sys._current_frames().get(main))] += 1

    def ours_s(self) -> float:
        """Return for how long of the longest block functions of the extension ran, in seconds, to a look."""
        return LOOK_S * sum(count for name, count in self.within.items() if name not in ("Blender", "test"))


def what_runs(frame: FrameType | None) -> str:
    """Return the innermost function of the extension on a stack, "test" for one of a test's, "Blender" for none."""
    found = "Blender" if frame is None else "test"
    while frame is not None:
        if OURS in frame.f_code.co_filename:
            return f"{frame.f_code.co_filename.split(OURS, 1)[1].strip('/').removesuffix('.py')}.{frame.f_code.co_name}"
        frame = frame.f_back
    return found


heart = Heart()


def watch() -> None:
    """Look at the thread that calls this from now on, from another thread."""
    main = threading.get_ident()

    def looking() -> None:
        while True:
            time.sleep(LOOK_S)
            heart.look(main)

    threading.Thread(target=looking, daemon=True).start()


def uncounted(work: Callable[P, R]) -> Callable[P, R]:
    """Make a function of the test's own, whose time is no block of the window."""

    @wraps(work)
    def apart(*arguments: P.args, **named: P.kwargs) -> R:
        begun, heart.apart = time.monotonic(), heart.apart + 1
        try:
            return work(*arguments, **named)
        finally:
            heart.apart -= 1
            if heart.apart == 0:  # what one of them calls is part of it
                heart.last += time.monotonic() - begun

    return apart
