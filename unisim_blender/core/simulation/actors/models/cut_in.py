"""The model `cut_in`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ....scenario.json_schema import SchemaOf
from ....world.actor_path import ActorPath, joined
from ....world.drive import EGO, Actor
from ...states import ActorState, Footprint, Traffic
from ..follow import PathProgress
from ..model import ActorMotion, Answer, Duration, Length, register
from ..recording import LANE_TURN_RAD, Recording
from .auto import Auto
from .idm import FollowingMemory, RecordedMemory

NEAR_M = 40.0
"""More than half the lengths of two vehicles and what they are aside of each other."""
BESIDE_M = 8.0
"""No vehicle cuts in from further aside."""
SHORTEST_M = 5.0
"""A change of lanes takes at least this way, however slow it is."""


@register
@dataclass(frozen=True)
class CutIn(Auto):
    """As `auto` until it is ahead of the ego vehicle, in its direction, by ``cut_in_gap_m`` or more and ``cut_in_headway_s`` or
    less: then it changes into the ego's lane.

    Gaps are between the boxes, along the ego's recorded path. The change takes about ``duration_s``: its length is that time at
    the mean of the speeds at its start and end, and its distance aside is a quintic of the way. From its start on the vehicle
    wants the ego's speed at that time plus ``speed_difference_m_s``, and follows as `idm` does, along the ego's path, as far
    aside of it as the ego is.
    """

    type = "cut_in"

    cut_in_gap_m: Length = 5.0
    cut_in_headway_s: Duration = 2.0
    duration_s: Duration = 3.0
    speed_difference_m_s: Annotated[float, SchemaOf({"type": "number", "minimum": -100, "maximum": 100})] = -2.0

    def answer(self, actor: Actor, motion: ActorMotion, traffic: Traffic, time_us: int, step_us: int) -> Answer:
        memory = motion.memory
        if motion.state.present and isinstance(memory, RecordedMemory | FollowingMemory) and self._may_change(memory):
            if self._is_near(motion.state, traffic.ego) and self._is_time(
                actor, motion.state, lane := ego_lane(memory.world, traffic.ego), traffic.ego
            ):
                changing = self._change(actor, motion.state, memory.world, lane, traffic.ego)
                return self.follow(actor, changing, time_us, step_us)
        return super().answer(actor, motion, traffic, time_us, step_us)

    def _may_change(self, memory: RecordedMemory | FollowingMemory) -> bool:
        return memory.stage == 0 if isinstance(memory, FollowingMemory) else memory.people is None

    def _is_near(self, state: ActorState, ego: Footprint) -> bool:
        """Return whether it could be time: quickly, for those that are far away."""
        x, y, _ = state.position_m
        return math.hypot(x - ego.x_m, y - ego.y_m) <= self.cut_in_headway_s * ego.speed_m_s + NEAR_M

    def _is_time(self, actor: Actor, state: ActorState, lane: ActorPath, ego: Footprint) -> bool:
        own_s, own_left = lane.project(*state.position_m[:2])
        ego_s, ego_left = lane.project(ego.x_m, ego.y_m)
        gap = own_s - ego_s - (float(actor.size_m[0]) + ego.length_m) / 2
        near = self.cut_in_gap_m <= gap <= self.cut_in_headway_s * ego.speed_m_s
        turn = math.remainder(state.heading_rad - float(lane.headings_at(np.array(own_s))), math.tau)
        return near and abs(own_left - ego_left) <= BESIDE_M and abs(turn) <= LANE_TURN_RAD and own_s > 0

    def _change(
        self, actor: Actor, state: ActorState, world: Recording, lane: ActorPath, ego: Footprint
    ) -> FollowingMemory:
        target = max(ego.speed_m_s + self.speed_difference_m_s, 0.0)
        length = max((state.speed_m_s + target) / 2 * self.duration_s, SHORTEST_M)
        s, _ = lane.project(*state.position_m[:2])
        _, left = lane.project(ego.x_m, ego.y_m)
        onto = joined(lane, s, state.position_m, state.quaternion_wxyz, length, left, keeps_height=True)
        onto = onto.at_speed(target)
        progress = PathProgress(onto, 0.0, state.speed_m_s, ignored=world.passed(actor, onto), least_m_s=0.0)
        return FollowingMemory(world, progress, stage=1)


def ego_lane(world: Recording, ego: Footprint) -> ActorPath:
    """Return the ego vehicle's recorded path, continued; straight ahead of it where that stands."""
    lane = world.continued(EGO)
    if lane is not None:
        return lane
    return ActorPath.straight((ego.x_m, ego.y_m, 0.0), ego.heading_rad)
