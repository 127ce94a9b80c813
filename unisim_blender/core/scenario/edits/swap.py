"""The edit `swap`."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...world.drive import Drive
from ..actors import current, with_actor
from ..context import Context
from ..edit import Edit, register
from ..fragments import PATH, TEXT
from ..motion import beside


@register
@dataclass(frozen=True)
class Swap(Edit):
    """Another actor's look and box, on the same ground."""

    type = "swap"
    members = {"actor": TEXT, "look": TEXT, "scene": PATH}
    seen_by = "swap"

    actor: str
    look: str
    scene: str | None = None

    def apply(self, drive: Drive, place: str, context: Context) -> Drive:
        """The drive with another look in the actor's place: the look's box and class, its underside where the actor's was. A
        scale that the actor had before is not the new look's."""
        actor = current(drive, self.actor, f"{place}.actor", context)
        appearance = context.appearance_of(self.look, self.scene, place, "look")
        raised = (appearance.size_m[2] - actor.size_m[2]) / 2
        trajectory = beside(actor.world_from_actor, (0.0, 0.0, raised), None, None) if raised else actor.world_from_actor
        swapped = replace(
            actor, label=appearance.label, size_m=appearance.size_m, appearance=appearance.appearance, scale=(1.0, 1.0, 1.0)
        )
        return with_actor(drive, replace(swapped, world_from_actor=trajectory))
