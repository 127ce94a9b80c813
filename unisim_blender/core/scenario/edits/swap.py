"""The edit `swap`."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...world.drive import Drive
from ..context import EditContext, current, with_actor
from ..edit import Edit, register
from ..json_schema import FilePath
from ..motion.trajectories import beside


@register
@dataclass(frozen=True)
class Swap(Edit):
    """Give the actor the appearance, class and box of another one, on the same ground."""

    type = "swap"
    former_names = {"look": "appearance"}
    seen_by = "actors"

    actor: str
    appearance: str
    scene: FilePath | None = None

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with the new appearance, box and class at the actor's place; the undersides of both boxes
        are at one height. The new box has the size of its appearance: an earlier scale of the actor ends."""
        actor = current(drive, self.actor, f"{place}.actor", context)
        source = context.appearance_of(self.appearance, self.scene, place, "appearance")
        raised = (source.size_m[2] - actor.size_m[2]) / 2
        trajectory = (
            beside(actor.world_from_actor, (0.0, 0.0, raised), None, None) if raised else actor.world_from_actor
        )
        swapped = replace(
            actor,
            label=source.label,
            size_m=source.size_m,
            appearance=source.appearance,
            scale=(1.0, 1.0, 1.0),
            lamps=(),
        )
        return with_actor(drive, replace(swapped, world_from_actor=trajectory))
