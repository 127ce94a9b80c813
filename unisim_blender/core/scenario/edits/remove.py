"""The edit `remove`."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...world.drive import Drive
from ..context import EditContext, current
from ..edit import Edit, register


@register
@dataclass(frozen=True)
class Remove(Edit):
    """The actor is not there."""

    type = "remove"
    seen_by = "actors"

    actor: str

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        current(drive, self.actor, f"{place}.actor", context)
        return replace(drive, actors={uid: actor for uid, actor in drive.actors.items() if uid != self.actor})

    def removes(self, uid: str) -> bool:
        return uid == self.actor
