"""The edit `cross`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import Trajectory
from ...world.drive import Actor, Drive
from ..checks import require
from ..context import EditContext
from ..edit import register
from ..json_schema import NotNegative, Positive
from ..motion.maneuvers import Maneuver, ego_course, ego_front_m, frame_times, throughout
from ..types import Scenario
from .cut_in import Side

FROM_M = 6.0
START_M_S2 = 1.0
"""Acceleration from where it stands, and deceleration to where it stops, at least."""


@register
@dataclass(frozen=True)
class Cross(Maneuver):
    """The actor goes straight across the ego vehicle's path from a side, and is on it at a time, a gap ahead of the ego's
    front; it stands before and afterwards."""

    type = "cross"

    at_s: float
    side: Side
    speed_m_s: Positive
    gap_s: NotNegative | None = None
    gap_m: NotNegative | None = None
    from_m: Positive | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        require((self.gap_s is None) != (self.gap_m is None), place, "needs gap_s or gap_m, one of them")

    def window(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> tuple[float, float]:
        return context.presence(None, place)

    def motion(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> Trajectory:
        ego, at_s = ego_course(drive, place), context.check_time(self.at_s, f"{place}.at_s")
        gap = self.gap_m if self.gap_s is None else self.gap_s * float(ego.speed(at_s))
        assert gap is not None  # one of both is there: the scenario was checked
        ahead = np.array([float(ego.gone(at_s)) + ego_front_m(context.scenario) + gap])
        (middle,), (heading,) = ego.beside(ahead)
        speed, aside = self.speed_m_s, self.from_m or FROM_M
        change = max(START_M_S2, speed**2 / aside)  # at its speed half way to the path
        ramp_s, even_s = speed / change, aside / speed - speed / change / 2
        times = frame_times(context)
        since = np.abs(times - at_s)  # alike before and after
        slower = np.clip(since - even_s, 0.0, ramp_s)
        away = np.where(since < even_s, speed * since, speed * (even_s + slower) - change * slower**2 / 2)
        along = np.sign(times - at_s) * away
        turn = heading - np.pi / 2 if self.side == "left" else heading + np.pi / 2
        _, _, up = ego.nearest(actor.world_from_actor.at(times[0])[:3, 3])
        places = middle + along[:, None] * [np.cos(turn), np.sin(turn), 0.0] + [0.0, 0.0, up]
        return throughout(times, places, np.full(len(times), turn))
