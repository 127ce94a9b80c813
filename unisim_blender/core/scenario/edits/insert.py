"""The edit `insert`."""

from __future__ import annotations

from dataclasses import dataclass

from ...world.drive import Drive
from ..context import EditContext, check_new, newcomer, with_actor
from ..edit import Edit, register
from ..json_schema import PATH, TEXT
from ..motion.keys import ACTOR_PATH, Keyframe, Present, check_path
from ..motion.placement import Placement
from ..types import Scenario


@register
@dataclass(frozen=True)
class Insert(Edit):
    """An actor of this or of another trained scene, on a path of its own or standing still."""

    type = "insert"
    members = {"actor": TEXT, "scene": PATH, "id": TEXT, **ACTOR_PATH}
    seen_by = "actors"

    actor: str
    id: str
    scene: str | None = None
    pose: Placement | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    outside: str | None = None
    present: Present | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        """Refuse a path that is missing or contradicts itself."""
        check_path(self, place)

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with another actor, of this or of another trained scene."""
        source = context.appearance_of(self.actor, self.scene, place, "actor")
        check_new(drive, self.id, place, context)
        trajectory = context.trajectory(self.pose, self.trajectory, self.outside, place)
        start, end = context.presence(self.present, place)
        return with_actor(drive, newcomer(source, self.id, trajectory, start, end))
