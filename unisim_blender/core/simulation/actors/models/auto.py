"""The model `auto`."""

from __future__ import annotations

from dataclasses import dataclass

from ....world.drive import EGO, Actor
from ...footprints import time_to_overlap
from ...states import Footprint, Traffic
from ..model import ActorMotion, Answer, Duration, Length, register
from ..recording import Recording
from .idm import Idm, RecordedMemory


@register
@dataclass(frozen=True)
class Auto(Idm):
    """As recorded, until the ego vehicle is ``departure_m`` off its recorded place or a conflict is foreseen within
    ``horizon_s``; from then on as `idm`.

    A conflict is foreseen if this box and one that is not where the recording has it overlap when both keep their velocities,
    and those at their recorded places would not.
    """

    type = "auto"

    departure_m: Length = 1.0
    horizon_s: Duration = 3.0

    def released(
        self, actor: Actor, motion: ActorMotion, memory: RecordedMemory, traffic: Traffic, time_us: int, step_us: int
    ) -> Answer:
        """Return the recorded state as long as nothing speaks against it, then as `Idm` does."""
        if memory.waits or self.leaves(actor, motion, memory.world, traffic, time_us, step_us):
            return super().released(actor, motion, memory, traffic, time_us, step_us)
        return ActorMotion(memory.world.state(actor.uid, time_us + step_us), memory)

    def leaves(
        self, actor: Actor, motion: ActorMotion, world: Recording, traffic: Traffic, time_us: int, step_us: int
    ) -> bool:
        """Return whether the actor can no longer be where the recording has it."""
        strays = world.strays(traffic)
        if strays.ego_m > self.departure_m and EGO in traffic.by_uid:
            return True
        if not motion.state.present or not strays.uids:
            return False
        own = traffic.by_uid[actor.uid]
        met = [uid for uid, _ in strays.overlaps(own, self.horizon_s) if uid != own.uid]
        return any(self._is_new(own, traffic.by_uid[uid], world, time_us) for uid in met)

    def _is_new(self, own: Footprint, other: Footprint, world: Recording, time_us: int) -> bool:
        """Return whether a box and one that has strayed would not meet if the other were where the recording has it."""
        recorded = world.footprint(other.uid, time_us, other)
        return recorded is None or time_to_overlap(own, recorded, self.horizon_s) is None
