"""For how long the window did nothing else, without what the test itself does."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

BEAT_S = 0.005
P = ParamSpec("P")
R = TypeVar("R")


class Heart:
    """Measures for how long the window did nothing else at most, in seconds."""

    def __init__(self) -> None:
        self.last = time.monotonic()
        self.longest = 0.0

    def beat(self) -> float:
        """Called by a timer of Blender's."""
        now = time.monotonic()
        self.longest = max(self.longest, now - self.last - BEAT_S)
        self.last = now
        return BEAT_S

    def begin(self) -> None:
        """Forget what was measured."""
        self.longest, self.last = 0.0, time.monotonic()


heart = Heart()


def uncounted(work: Callable[P, R]) -> Callable[P, R]:
    """Make a function of the test's own, whose time is no block of the window."""

    @wraps(work)
    def apart(*arguments: P.args, **named: P.kwargs) -> R:
        begun = time.monotonic()
        try:
            return work(*arguments, **named)
        finally:
            heart.last += time.monotonic() - begun

    return apart
