"""The model `auto`."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ....world.drive import Actor
from ...states import EGO, Footprint, Traffic
from ..conflict import time_to_overlap
from ..model import Motion, register
from ..parameters import DURATION, LENGTH
from ..recording import Recording
from .idm import DRIVER, Idm, Recorded


@register
@dataclass(frozen=True)
class Auto(Idm):
    """As recorded, until the ego vehicle is ``departure_m`` off its recorded place or a conflict is foreseen within
    ``horizon_s``; from then on as `idm`.

    A conflict is foreseen if this box and one that is not where the recording has it overlap when both keep their velocities,
    and those at their recorded places would not.
    """

    type = "auto"
    members = {**DRIVER, "departure_m": LENGTH, "horizon_s": DURATION}

    departure_m: float = 1.0
    horizon_s: float = 3.0

    def released(
        self, actor: Actor, motion: Motion, memory: Recorded, traffic: Traffic, time_us: int, step_us: int
    ) -> Motion:
        """Return the recorded state as long as nothing speaks against it, then as `Idm` does."""
        if memory.waits or self.leaves(actor, motion, memory.world, traffic, time_us, step_us):
            return super().released(actor, motion, memory, traffic, time_us, step_us)
        return replace(motion, state=memory.world.state(actor.uid, time_us + step_us))

    def leaves(
        self, actor: Actor, motion: Motion, world: Recording, traffic: Traffic, time_us: int, step_us: int
    ) -> bool:
        """Return whether the actor can no longer be where the recording has it."""
        strays = world.strays(traffic)
        if strays.ego_m > self.departure_m and EGO in traffic.by_uid:
            return True
        if not motion.state.present or not strays.uids:
            return False
        return any(
            uid != actor.uid and self._foresees(actor, motion, traffic.by_uid[uid], world, time_us)
            for uid in strays.uids
        )

    def _foresees(self, actor: Actor, motion: Motion, other: Footprint, world: Recording, time_us: int) -> bool:
        state, (length, width, _) = motion.state, actor.size_m.tolist()
        x, y, _ = state.position_m
        own = Footprint(actor.uid, actor.label, x, y, state.heading_rad, length, width, state.speed_m_s)
        if time_to_overlap(own, other, self.horizon_s) is None:
            return False
        recorded = world.footprint(other.uid, time_us, other)
        return recorded is None or time_to_overlap(own, recorded, self.horizon_s) is None
