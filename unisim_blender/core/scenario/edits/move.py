"""The edit `move`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...geometry import Trajectory, Vector3
from ...world.drive import Actor, Drive
from ..checks import require
from ..context import EditContext, current, with_actor
from ..edit import register
from ..motion.keys import ActorPathEdit
from ..motion.paths import ahead, is_path
from ..motion.trajectories import TimeMap, beside, is_moving, retimed
from ..types import Scenario


@register
@dataclass(frozen=True)
class Move(ActorPathEdit):
    """A new trajectory, a place to stand, or the actor's own trajectory: ahead along its path, displaced along its axes
    and delayed."""

    type = "move"
    seen_by = "actors"

    actor: str
    offset_m: Vector3 | None = None
    later_s: float | None = None
    ahead_m: float | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        shifted = [name for name in ("ahead_m", "offset_m", "later_s") if getattr(self, name) is not None]
        require(not (shifted and self.has_path), place, f"has {', '.join(shifted)} beside a path of its own")
        self.check_path(place, needed=not shifted)

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with the actor on another path; it is there when it was, or later, unless the edit says
        when."""
        actor = current(drive, self.actor, f"{place}.actor", context)
        if not self.has_path:
            actor = shifted(actor, self.offset_m, self.later_s or 0.0, self.ahead_m or 0.0, context.recorded)
            trajectory, keyed = actor.world_from_actor, actor.is_moving
        else:
            trajectory = self.path(place, context)
            keyed = self.trajectory is not None and len(self.trajectory) > 1
        start, end = (actor.start_s, actor.end_s) if self.present is None else context.presence(self.present, place)
        return with_actor(drive, moved(actor, trajectory, (start, end), keyed))


def shifted(actor: Actor, offset_m: Vector3 | None, later_s: float, ahead_m: float, drive: Drive) -> Actor:
    """Return an actor of a drive ahead along its path, or its own axis where it goes nowhere, displaced along its own
    axes, and delayed: where it is and when it is present."""
    trajectory = actor.world_from_actor
    if ahead_m and is_path(trajectory.positions):
        trajectory = ahead(trajectory, np.array(sorted(drive.time_s.values())), ahead_m)
    elif ahead_m:
        trajectory = beside(trajectory, (ahead_m, 0.0, 0.0), None, None)
    trajectory = beside(trajectory, offset_m if offset_m and any(offset_m) else None, None, None)
    if later_s:
        trajectory = retimed(trajectory, TimeMap(np.array([later_s]), np.zeros(1)))
    start, end = actor.start_s + later_s, actor.end_s + later_s
    return replace(actor, world_from_actor=trajectory, start_s=start, end_s=end)


def moved(actor: Actor, trajectory: Trajectory, window_s: tuple[float, float], keyed: bool) -> Actor:
    """Return an actor on another trajectory, present between two times. ``keyed``: it goes along several keys, and so
    it counts as moving."""
    # whether it moves must not depend on how much of its trajectory is known: simulations go on with it
    moving = keyed or is_moving(trajectory)
    start, end = window_s
    return replace(actor, world_from_actor=trajectory, start_s=start, end_s=end, is_moving=moving)
