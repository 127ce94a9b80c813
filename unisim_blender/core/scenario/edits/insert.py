"""The edit `insert`."""

from __future__ import annotations

from dataclasses import dataclass

from ...world.drive import Drive
from ..context import EditContext, check_new, newcomer, with_actor
from ..edit import register
from ..json_schema import FilePath
from ..motion.keys import ActorPathEdit


@register
@dataclass(frozen=True)
class Insert(ActorPathEdit):
    """An actor of this or of another trained scene, on a path of its own or standing still."""

    type = "insert"
    seen_by = "actors"

    actor: str
    id: str
    scene: FilePath | None = None

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        source = context.appearance_of(self.actor, self.scene, place, "actor")
        check_new(drive, self.id, place, context)
        trajectory = self.path(place, context)
        start, end = context.presence(self.present, place)
        return with_actor(drive, newcomer(source, self.id, trajectory, start, end))
