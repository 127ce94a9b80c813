"""The edit `move`."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...geometry import Trajectory
from ...world.drive import Actor, Drive
from ..context import EditContext, current, with_actor
from ..edit import Edit, register
from ..json_schema import TEXT
from ..motion.keys import ACTOR_PATH, Keyframe, Present, check_path
from ..motion.placement import Placement
from ..motion.trajectories import is_moving
from ..types import Scenario


@register
@dataclass(frozen=True)
class Move(Edit):
    """A new trajectory, or a place to stand."""

    type = "move"
    members = {"actor": TEXT, **ACTOR_PATH}
    seen_by = "actors"

    actor: str
    pose: Placement | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    outside: str | None = None
    present: Present | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        """Refuse a path that is missing or contradicts itself."""
        check_path(self, place)

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with the actor on another path; it is there when it was, unless the edit says when."""
        actor = current(drive, self.actor, f"{place}.actor", context)
        trajectory = context.trajectory(self.pose, self.trajectory, self.outside, place)
        start, end = (actor.start_s, actor.end_s) if self.present is None else context.presence(self.present, place)
        keyed = self.trajectory is not None and len(self.trajectory) > 1
        return with_actor(drive, moved(actor, trajectory, (start, end), keyed))


def moved(actor: Actor, trajectory: Trajectory, window_s: tuple[float, float], keyed: bool) -> Actor:
    """Return an actor on another trajectory, present between two times. ``keyed``: it goes along several keys, and so it
    counts as moving."""
    # whether it moves must not depend on how much of its trajectory is known: simulations go on with it
    moving = keyed or is_moving(trajectory)
    start, end = window_s
    return replace(actor, world_from_actor=trajectory, start_s=start, end_s=end, is_moving=moving)
