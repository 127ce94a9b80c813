"""The edit `duplicate`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import Vector3
from ...world.drive import Drive
from ..checks import require
from ..context import EditContext, check_new, current, newcomer, with_actor
from ..edit import register
from ..motion.keys import ActorPathEdit
from ..motion.trajectories import TimeMap, beside, retimed
from ..types import Scenario


@register
@dataclass(frozen=True)
class Duplicate(ActorPathEdit):
    """A second actor with the source's appearance: displaced, later, or on a path of its own."""

    type = "duplicate"
    seen_by = "actors"

    actor: str
    id: str
    offset_m: Vector3 | None = None
    world_offset_m: Vector3 | None = None
    turn_deg: float | None = None
    time_offset_s: float | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        names = "offset_m", "time_offset_s", "turn_deg", "world_offset_m"
        displaced = [name for name in names if getattr(self, name) is not None]
        require(not (displaced and self.has_path), place, f"has {', '.join(displaced)} beside a path of its own")
        self.check_path(place, needed=False)

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        source = current(drive, self.actor, f"{place}.actor", context)
        check_new(drive, self.id, place, context)
        if self.has_path:
            trajectory = self.path(place, context)
            start, end = source.start_s, source.end_s
        else:
            trajectory = beside(source.world_from_actor, self.offset_m, self.world_offset_m, self.turn_deg)
            later = self.time_offset_s or 0.0
            trajectory = retimed(trajectory, TimeMap(np.array([later]), np.zeros(1))) if later else trajectory
            start, end = source.start_s + later, source.end_s + later
        if self.present is not None:
            start, end = context.presence(self.present, place)
        return with_actor(drive, newcomer(source, self.id, trajectory, start, end))
