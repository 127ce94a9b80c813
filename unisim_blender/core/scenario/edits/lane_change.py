"""The edit `lane_change`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import Trajectory
from ...world.drive import Actor, Drive
from ..context import EditContext
from ..edit import register
from ..json_schema import Positive
from ..motion.maneuvers import SPEED_S, Maneuver, ease, frame_times, joined, needed_m, own_course, too_late


@register
@dataclass(frozen=True)
class LaneChange(Maneuver):
    """The actor goes on along its path, from a time on so far to the left of it."""

    type = "lane_change"

    at_s: float
    left_m: float
    duration_s: Positive | None = None

    def motion(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> Trajectory:
        """Return the trajectory; without a duration, that of a comfortable change."""
        course = own_course(actor, self.at_s, place)
        start, times = float(course.gone(self.at_s)), frame_times(context, self.at_s)
        end_s = min(actor.end_s, times[-1])
        gone = course.gone(times)
        if self.duration_s is None:
            fastest = float(course.speed(times[times <= self.at_s + 4.0]).max())
            length = needed_m(self.left_m, fastest)
        else:
            end_s = min(end_s, self.at_s + self.duration_s)
            length = float(course.gone(self.at_s + self.duration_s)) - start
        speed = max(float(course.speed(self.at_s)), SPEED_S)
        if course.gone(end_s) - start < length - 0.01 or self.at_s + (self.duration_s or 0.0) > end_s + 1e-6:
            too_late(place, f'the lane change of "{actor.uid}"', self.duration_s or length / speed, end_s - self.at_s)
        share = (gone - start) / length
        places, headings = course.beside(gone, self.left_m * ease(share))
        slope = self.left_m / length * 30 * np.clip(share * (1 - share), 0, None) ** 2
        return joined(actor, self.at_s, times, places, headings + np.arctan(np.where(share < 1, slope, 0.0)))
