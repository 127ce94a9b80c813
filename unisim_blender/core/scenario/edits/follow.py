"""The edit `follow`."""

from __future__ import annotations

from dataclasses import dataclass

from ...geometry import Trajectory
from ...world.drive import Actor, Drive
from ..checks import require
from ..context import EditContext, current
from ..edit import register
from ..json_schema import NotNegative
from ..motion.maneuvers import DrivenPath, Maneuver, frame_times, throughout
from ..types import Scenario


@register
@dataclass(frozen=True)
class Follow(Maneuver):
    """The actor follows a leader on its path as Newell's drivers do (2002): so much later, and a gap behind its rear."""

    type = "follow"

    leader: str
    gap_s: NotNegative
    gap_m: NotNegative

    def check(self, scenario: Scenario, place: str) -> None:
        require(self.leader != self.actor, f"{place}.leader", f'"{self.actor}" cannot follow itself')

    def window(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> tuple[float, float]:
        leader = drive.actors[self.leader]
        return leader.start_s, leader.end_s

    def motion(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> Trajectory:
        leader, times = current(drive, self.leader, f"{place}.leader", context), frame_times(context)
        course = DrivenPath.of(leader.world_from_actor)
        require(course is not None, f"{place}.leader", f'"{self.leader}" stands: there is nothing to follow')
        assert course is not None
        behind = self.gap_m + float(leader.size_m[0] + actor.size_m[0]) / 2
        places, headings = course.beside(course.gone(times - self.gap_s) - behind)
        lower = (leader.size_m[2] - actor.size_m[2]) / 2
        return throughout(times, places - [0.0, 0.0, lower], headings)
