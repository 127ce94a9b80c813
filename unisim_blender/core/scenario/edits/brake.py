"""The edit `brake`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import Trajectory
from ...world.drive import Actor, Drive
from ..checks import require
from ..context import EditContext
from ..edit import register
from ..json_schema import NotNegative, Positive
from ..motion.maneuvers import RAMP_S, Maneuver, frame_times, joined, own_course

STEP_S = 0.01


@register
@dataclass(frozen=True)
class Brake(Maneuver):
    """The actor brakes on its path from a time on, to a speed that it keeps, or for ``stands_s`` before it speeds up again;
    never faster than before at any place."""

    type = "brake"

    at_s: float
    deceleration_m_s2: Positive
    speed_m_s: NotNegative | None = None
    stands_s: NotNegative | None = None
    acceleration_m_s2: Positive | None = None

    def motion(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> Trajectory:
        course, slow = own_course(actor, self.at_s, place), self.speed_m_s or 0.0
        before = float(course.speed(self.at_s))
        require(
            before > slow,
            f"{place}.speed_m_s",
            f'"{actor.uid}" goes {before:.1f} m/s at {self.at_s:g} s, which is no faster than {slow:g} m/s',
        )
        times = frame_times(context, self.at_s)
        fine = np.arange(self.at_s, times[-1] + STEP_S, STEP_S)
        ramp = min(RAMP_S, (before - slow) / self.deceleration_m_s2)
        # a speed that falls evenly, averaged over the ramp, begins and ends to fall smoothly
        falling = before - self.deceleration_m_s2 * (fine[:, None] - self.at_s - np.linspace(0, ramp, 9))
        speeds = np.clip(falling, slow, before).mean(1)
        if self.stands_s is not None:
            again = fine - self.at_s - (before - slow) / self.deceleration_m_s2 - ramp - self.stands_s
            speeds = np.where(again > 0, slow + (self.acceleration_m_s2 or self.deceleration_m_s2) * again, speeds)
        own = course.speed(fine).tolist()
        # the time at which it was there before: that passes no faster, so it is nowhere faster either
        reached, then = np.empty(len(fine)), self.at_s
        for i, speed in enumerate(speeds.tolist()):
            reached[i] = then
            then += STEP_S * min(1.0, speed / max(own[int((then - self.at_s) / STEP_S)], 1e-6))
        places, headings = course.beside(course.gone(np.interp(times, fine, reached)))
        return joined(actor, self.at_s, times, places, headings)
