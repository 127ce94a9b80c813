"""Changes of when an actor is where on its trajectory, and what they come to in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...core.geometry import FloatArray
from ..sampled.clock import Clock
from ..texts import Text
from .durations import duration, instant, later_or_earlier, span, stretched


@dataclass(frozen=True)
class Retiming:
    """A change of times. ``mode`` is DELAY: all is later by ``seconds``; SPEED: from now on ``speed`` times as fast;
    STOP: it stands for ``seconds`` from now on; STRETCH: from ``first_s`` to ``last_s`` ``speed`` times as fast.

    Times are the log's, in seconds.
    """

    mode: str
    seconds: float
    speed: float
    first_s: float
    last_s: float

    def lines(self, now_s: float, clock: Clock) -> list[str]:
        """Return what the change comes to, in seconds and in frames."""
        if self.mode == "STRETCH":
            return stretched(self.first_s, self.last_s, self.speed, clock)
        if self.mode == "SPEED":
            return [
                Text("From {time} on", time=instant(now_s, clock)),
                Text("What takes 1 s takes {duration}", duration=duration(1 / self.speed, clock)),
            ]
        if self.mode == "STOP":
            stands = abs(self.seconds)
            return [Text("Stands for {duration}", duration=duration(stands, clock)), span(now_s, now_s + stands, clock)]
        return [later_or_earlier(self.seconds, clock)]

    def summary(self, now_s: float, clock: Clock) -> str:
        """Return what the change comes to, in one line that the status bar has room for."""
        if self.mode == "STRETCH":
            whole = duration(self.last_s - self.first_s, clock)
            return Text("speed x{speed:.3g} for {duration}", speed=self.speed, duration=whole)
        if self.mode == "SPEED":
            return Text("speed x{speed:.3g} from {time} on", speed=self.speed, time=instant(now_s, clock))
        if self.mode == "STOP":
            return Text("stands for {duration}", duration=duration(abs(self.seconds), clock))
        return self.lines(now_s, clock)[0]

    def frames_from(self, now_s: float, clock: Clock) -> Callable[[FloatArray], FloatArray]:
        """Return the function that takes keys' frames to their new frames; STOP has none, as it adds keys."""
        change = self._times_from(now_s)
        return lambda frames: clock.frame(change(clock.time_s(frames)))

    def _times_from(self, now_s: float) -> Callable[[FloatArray], FloatArray]:
        if self.mode == "DELAY":
            return lambda old: old + self.seconds
        if self.mode == "SPEED":
            return lambda old: np.where(old > now_s, now_s + (old - now_s) / self.speed, old)
        first, last = self.first_s, self.last_s
        longer = (last - first) * (1 / self.speed - 1)
        return lambda old: old + longer * np.clip((old - first) / (last - first), 0, 1)
