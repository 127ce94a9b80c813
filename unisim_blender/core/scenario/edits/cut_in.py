"""The edit `cut_in`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...geometry import FloatArray, Trajectory
from ...world.drive import Actor, Drive
from ..checks import fail, require
from ..context import EditContext
from ..edit import register
from ..json_schema import Positive, SchemaOf
from ..motion.maneuvers import (
    FASTER_M_S2,
    SLOWER_M_S2,
    DrivenPath,
    Maneuver,
    Quintic,
    ease,
    ego_course,
    ego_front_m,
    frame_times,
    joined,
    needed_m,
    own_course,
    throughout,
    too_late,
)
from ..types import Scenario

Side = Annotated[str, SchemaOf({"enum": ["left", "right"]})]
LANE_M = 3.5
"""Width of a lane, where an edit does not say."""
LONGEST_S = 10.0
FARTHEST_M = 8.0
"""Actors further aside of the ego's path do not cut in from where they are."""


@register
@dataclass(frozen=True)
class CutInManeuver(Maneuver):
    """The actor changes into the ego vehicle's lane from a time on, ends it a gap ahead of the ego's front and keeps that
    or a speed; with a side, it drives in the lane beside until then."""

    type = "cut_in"

    at_s: float
    gap_s: Positive | None = None
    gap_m: Positive | None = None
    side: Side | None = None
    lane_m: Positive | None = None
    duration_s: Positive | None = None
    speed_m_s: Positive | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        require((self.gap_s is None) != (self.gap_m is None), place, "needs gap_s or gap_m, one of them")
        require(self.lane_m is None or self.side is not None, f"{place}.lane_m", "needs a side")

    def window(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> tuple[float, float]:
        return super().window(actor, drive, place, context) if self.side is None else context.presence(None, place)

    def motion(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> Trajectory:
        """Return the trajectory; without a duration, that of a comfortable change."""
        ego = ego_course(drive, place)
        ahead = ego_front_m(context.scenario) + float(actor.size_m[0]) / 2
        if self.side is not None:
            return self._from_lane(actor, ego, ahead, place, context)
        own, times = own_course(actor, self.at_s, place), frame_times(context, self.at_s)
        here = actor.world_from_actor.at(self.at_s)[:3, 3]
        gone, left, up = ego.nearest(here)
        (_, (course_heading,)) = own.beside(own.gone(np.array([self.at_s])))
        (_, (heading,)) = ego.beside(np.array([gone]))
        turned = (course_heading - heading + np.pi) % (2 * np.pi) - np.pi
        front = gone - float(ego.gone(self.at_s)) - ahead
        where = (
            f'"{actor.uid}" is {front:.0f} m in front of the ego vehicle and {abs(left):.0f} m aside at {self.at_s:g} s'
        )
        if abs(turned) > np.pi / 3 or abs(left) > FARTHEST_M:
            fail(place, f"{where}, in no lane beside it: give a side, which puts the actor into one")
        start = gone, float(own.speed(self.at_s)) * float(np.cos(turned)), 0.0
        left_s = min(times[-1], actor.end_s) - self.at_s
        spans = [self.duration_s] if self.duration_s else np.arange(1.5, min(LONGEST_S, left_s) + 0.01, 0.25).tolist()
        if not spans or spans[0] > left_s + 1e-6:
            too_late(place, f'the cut-in of "{actor.uid}"', self.duration_s or 1.5, left_s)
        for span in spans:
            end = self.at_s + span
            curve = Quintic(start, (self._target(ego, end, ahead), self._speed(ego, end), 0.0), span)
            at = np.linspace(0, span, 41)
            speeds, changes = curve.at(at, 1), curve.at(at, 2)
            length = float(curve.at(span)) - gone
            comfortable = self.duration_s or length >= needed_m(left, float(speeds.max()))
            if comfortable and speeds.min() >= 0 and -SLOWER_M_S2 <= changes.min() and changes.max() <= FASTER_M_S2:
                break
        else:
            gap = f"{self.gap_s:g} s" if self.gap_s else f"{self.gap_m:g} m"
            fail(place, f"{where}: it cannot be {gap} ahead within {spans[-1]:.1f} s; give another time, gap or a side")
        after = self._target(ego, end, ahead) + self._since(ego, end, times)
        along = np.where(times < end, curve.at(np.minimum(times, end) - self.at_s), after)
        aside = Quintic((left, float(np.tan(turned)), 0.0), (0.0, 0.0, 0.0), length)
        inside = np.clip(along - gone, 0.0, length)
        places, headings = ego.beside(along, np.where(along - gone < length, aside.at(inside), 0.0))
        slope = np.where(along - gone < length, aside.at(inside, 1), 0.0)
        return joined(actor, self.at_s, times, places + [0.0, 0.0, up], headings + np.arctan(slope))

    def _from_lane(self, actor: Actor, ego: DrivenPath, ahead: float, place: str, context: EditContext) -> Trajectory:
        """Return a trajectory in the lane beside, at the gap of the end or the speed, until it changes."""
        times = frame_times(context)
        left = (self.lane_m or LANE_M) * (1 if self.side == "left" else -1)
        fastest = self.speed_m_s or float(ego.speed(times[times >= self.at_s][:40]).max(initial=0.0))
        length = needed_m(left, fastest)
        ends = self.at_s + np.arange(self.duration_s or 0.5, (self.duration_s or 60.0) + 0.01, 0.1)
        # the speed may depend on when it ends
        for end in ends.tolist():
            along = self._target(ego, end, ahead) + self._since(ego, end, np.append(times, self.at_s))
            if self.duration_s or along[-1] + length <= self._target(ego, end, ahead):
                break
        if end > times[-1] + 1e-6:
            too_late(place, f'the cut-in of "{actor.uid}"', end - self.at_s, times[-1] - self.at_s)
        length = self._target(ego, end, ahead) - along[-1]
        require(length > 0.5, f"{place}.at_s", f"the ego vehicle stands at {self.at_s:g} s: give a speed_m_s")
        share = (along[:-1] - along[-1]) / length
        slope = -left / length * 30 * np.clip(share * (1 - share), 0, None) ** 2
        _, _, up = ego.nearest(actor.world_from_actor.at(times[0])[:3, 3])
        places, headings = ego.beside(along[:-1], left * (1 - ease(share)))
        return throughout(times, places + [0.0, 0.0, up], headings + np.arctan(slope))

    def _speed(self, ego: DrivenPath, time_s: float) -> float:
        return self.speed_m_s or float(ego.speed(time_s))

    def _target(self, ego: DrivenPath, time_s: float, ahead: float) -> float:
        """Return the arc length of its centre at the end of the change."""
        gap = self.gap_m if self.gap_s is None else self.gap_s * max(float(ego.speed(time_s)), 1.0)
        assert gap is not None  # one of both is there: the scenario was checked
        return float(ego.gone(time_s)) + ahead + gap

    def _since(self, ego: DrivenPath, end_s: float, times_s: FloatArray) -> FloatArray:
        """Return how far it has gone since the end of the change: at its speed, or as the ego vehicle goes."""
        if self.speed_m_s is not None:
            return np.asarray(self.speed_m_s * (times_s - end_s))
        return ego.gone(times_s) - ego.gone(end_s)
