"""The model `lane`."""

from __future__ import annotations

from dataclasses import dataclass

from ....world.actor_path import ActorPath
from ....world.captures import US_PER_SECOND
from ....world.drive import Actor
from ...states import Traffic
from ..model import ActorMotion, register
from ..recording import Recording
from .auto import Auto


@register
@dataclass(frozen=True)
class Lane(Auto):
    """As `auto`, and it drives on when its record ends: along other recorded paths that pass there in its direction, else
    straight on."""

    type = "lane"

    def path_of(self, actor: Actor, world: Recording) -> ActorPath | None:
        return world.continued(actor.uid)

    def leaves(
        self, actor: Actor, motion: ActorMotion, world: Recording, traffic: Traffic, time_us: int, step_us: int
    ) -> bool:
        """Return whether the actor can no longer be where the recording has it, or the recording ends."""
        ends = motion.state.present and (time_us + step_us) / US_PER_SECOND > world.windows_s[actor.uid][1]
        return ends or super().leaves(actor, motion, world, traffic, time_us, step_us)
