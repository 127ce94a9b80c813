"""The model `replay`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

from ....scenario.json_schema import SchemaOf
from ....world.actor_path import ActorPath
from ....world.captures import US_PER_SECOND
from ....world.drive import Actor
from ...states import ActorState, Traffic, actor_footprint
from ..lead import Search, touching
from ..model import ActorMotion, Answer, Model, Pending, register
from ..recording import Recording

BRAKING_M_S2 = 3.0
"""How hard a pedestrian or a rider stops."""
STEP_M = 0.2
LABEL_M = 0.5
"""A recorded place is at most so far from its path, which leaves out what labels wander."""


@dataclass(frozen=True)
class Walk:
    """Memory of an actor that replays: how much later than recorded it is, and how fast its time goes on, from 0 to 1."""

    world: Recording
    late_us: int = 0
    rate: float = 1.0


@register
@dataclass(frozen=True)
class Replay(Model):
    """As recorded, to the bit. Pedestrians stop ``gap_m`` before a vehicle's box in their way, and walk on when it has gone.

    A vehicle is in a pedestrian's way if it is not where the recording has it, or the pedestrian is late.
    """

    type = "replay"

    gap_m: Annotated[float, SchemaOf({"type": "number", "minimum": 0, "maximum": 100})] = 0.5

    def start(self, actor: Actor, world: Recording, time_us: int) -> ActorMotion:
        return ActorMotion(world.state(actor.uid, time_us), Walk(world))

    def answer(self, actor: Actor, motion: ActorMotion, traffic: Traffic, time_us: int, step_us: int) -> Answer:
        """Return the recorded state at the end of the step, or for a late pedestrian an earlier one."""
        memory = motion.memory
        assert isinstance(memory, Walk)
        world, later_us = memory.world, time_us + step_us
        path = world.paths[actor.uid] if actor.uid in world.people else None
        if path is None or not motion.state.present:
            if memory.late_us == 0 and memory.rate == 1.0:
                return ActorMotion(world.state(actor.uid, later_us), memory)
            late_s = (later_us - memory.late_us) / US_PER_SECOND
            return ActorMotion(world.state_at(actor.uid, late_s, memory.rate), memory)
        s = path.s_at_time((time_us - memory.late_us) / US_PER_SECOND)
        pace = path.speed_at(s)

        def walked(halts: bool) -> ActorMotion:
            change = BRAKING_M_S2 / max(pace, 0.5) * step_us / US_PER_SECOND
            rate = max(memory.rate - change, 0.0) if halts else min(memory.rate + change, 1.0)
            late_us = memory.late_us + round((1 - rate) * step_us)
            recorded_s = (later_us - late_us) / US_PER_SECOND
            return ActorMotion(world.state_at(actor.uid, recorded_s, rate), replace(memory, late_us=late_us, rate=rate))

        search = self._search(actor, motion.state, path, s, pace, traffic, memory, step_us)
        return walked(False) if search is None else Pending(search, lambda lead: walked(lead is not None))

    def _search(
        self, actor: Actor, state: ActorState, path: ActorPath, s_m: float, pace: float, traffic: Traffic, memory: Walk,
        step_us: int,
    ) -> Search | None:  # fmt: skip
        """Return the search for a vehicle in the way of where the recording walks next; None where none is near."""
        world, (length, width, _) = memory.world, actor.size_m.tolist()
        x, y, _ = state.position_m
        ahead = self.gap_m + pace * pace / (2 * BRAKING_M_S2) + pace * step_us / US_PER_SECOND
        reach = ahead + STEP_M + LABEL_M + math.hypot(length, width) / 2
        others = traffic.footprints if memory.late_us else map(traffic.by_uid.__getitem__, world.strays(traffic).uids)
        vehicles = {
            footprint.uid
            for footprint in others
            if footprint.uid not in world.people
            and math.hypot(footprint.x_m - x, footprint.y_m - y)
            <= reach + math.hypot(footprint.length_m, footprint.width_m) / 2
        }
        vehicles -= {actor.uid}
        if not vehicles:
            return None
        ignored = {footprint.uid for footprint in traffic.footprints} - vehicles
        ignored |= world.passed(actor, path)
        # too late to stop before it
        ignored |= set(touching(actor_footprint(actor, state), traffic))
        return Search(path, s_m, ahead, STEP_M, actor.uid, length, width, ignored)
