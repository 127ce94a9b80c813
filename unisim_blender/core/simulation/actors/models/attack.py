"""The model `attack`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....geometry import FloatArray, quaternion_from_yaw, quaternion_product
from ....world.actor_path import ActorPath
from ....world.captures import US_PER_SECOND
from ....world.drive import EGO, Actor
from ...states import ActorState, FootprintArrays, Traffic, actor_footprint
from ..follow import HARDEST_M_S2
from ..lead import touching
from ..model import Acceleration, ActorMotion, Answer, Count, Duration, Length, Speed, register
from ..recording import Recording
from .auto import Auto
from .idm import FollowingMemory, RecordedMemory

LONGITUDINAL = np.array([-1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0])
LATERAL = np.array([-1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0])
"""The grid of accelerations, as parts of the largest ones."""
TIGHTEST_PER_M = 0.2
"""Curvature of the narrowest turn."""
SLOWEST_M_S = 3.0
"""Lateral accelerations are turned into curvatures at this speed at least."""
EASE_S = 0.5
"""Time in which the curvature goes over into a new one, evenly."""
FORECAST_US, PART_US = 100_000, 10_000
CLIMB = 0.2
"""How far up or down a vehicle is moved by metre of its way, towards the height of its recorded path."""


@dataclass(frozen=True)
class AttackMemory:
    """Memory of an attack: what was decided when, and the curvature that is driven."""

    world: Recording
    decided_us: int
    draws: int
    acceleration_m_s2: float
    curvature_per_m: float
    from_per_m: float
    to_per_m: float
    hit: bool = False


@register
@dataclass(frozen=True)
class Attack(Auto):
    """As `auto` until the ego vehicle is within ``range_m``: then it drives where that will be.

    Every ``decide_s`` it compares drives with constant accelerations along and across over ``forecast_s``, by how near they come
    to the ego vehicle, if that keeps its velocity, plus ``neighbour_cost_m`` for each other box that they meet, and takes one of
    the ``best`` at random. When it has touched the ego vehicle it brakes. The way of HUGSIM's attacks (Zhou et al., 2024), with
    drives of a vehicle in place of splines.
    """

    type = "attack"

    range_m: Length = 50.0
    forecast_s: Duration = 3.0
    decide_s: Duration = 0.5
    best: Count = 3
    neighbour_cost_m: Length = 0.1
    along_m_s2: Acceleration = 4.0
    across_m_s2: Acceleration = 3.0
    most_speed_m_s: Speed = 25.0

    def answer(self, actor: Actor, motion: ActorMotion, traffic: Traffic, time_us: int, step_us: int) -> Answer:
        memory, state = motion.memory, motion.state
        if isinstance(memory, RecordedMemory | FollowingMemory) and self._begins(actor, memory, state, traffic):
            curvature = 0.0
            if isinstance(memory, FollowingMemory):
                curvature = memory.progress.path.curvature_at(memory.progress.s_m)
            memory = AttackMemory(memory.world, time_us, 0, 0.0, curvature, curvature, curvature)
            memory = self._decided(actor, state, memory, traffic, time_us)
        if not isinstance(memory, AttackMemory):
            return super().answer(actor, motion, traffic, time_us, step_us)
        if not memory.hit and EGO in touching(actor_footprint(actor, state), traffic):
            memory = replace(memory, hit=True, acceleration_m_s2=-HARDEST_M_S2, to_per_m=memory.curvature_per_m)
        elif not memory.hit and time_us - memory.decided_us >= round(self.decide_s * US_PER_SECOND):
            memory = self._decided(actor, state, memory, traffic, time_us)
        return self._driven(actor, state, memory, time_us, step_us)

    def _begins(
        self, actor: Actor, memory: RecordedMemory | FollowingMemory, state: ActorState, traffic: Traffic
    ) -> bool:
        if isinstance(memory, RecordedMemory) and memory.people is not None:
            return False
        x, y, _ = state.position_m
        near = math.hypot(traffic.ego.x_m - x, traffic.ego.y_m - y) <= self.range_m
        return state.present and near and memory.world.paths[actor.uid] is not None

    def _decided(
        self, actor: Actor, state: ActorState, memory: AttackMemory, traffic: Traffic, time_us: int
    ) -> AttackMemory:
        """Return the attack with a new decision."""
        along, curvatures, places, headings = self._candidates(state, memory)
        costs = self._costs(actor, places, headings, traffic)
        ranked = np.argsort(costs, kind="stable")[: self.best]
        chosen = int(memory.world.generator(actor.uid, memory.draws).choice(ranked))
        return replace(
            memory,
            decided_us=time_us,
            draws=memory.draws + 1,
            acceleration_m_s2=float(along[chosen]),
            from_per_m=memory.curvature_per_m,
            to_per_m=float(curvatures[chosen]),
        )

    def _candidates(
        self, state: ActorState, memory: AttackMemory
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return accelerations and curvatures (C,) of drives, their places (C, T, 2) and headings (C, T) over the forecast."""
        along, across = (
            grid.ravel()
            for grid in np.meshgrid(LONGITUDINAL * self.along_m_s2, LATERAL * self.across_m_s2, indexing="ij")
        )
        curvatures = across / max(state.speed_m_s, SLOWEST_M_S) ** 2
        curvatures = np.clip(curvatures, -TIGHTEST_PER_M, TIGHTEST_PER_M)
        dt = FORECAST_US / US_PER_SECOND
        middles = (np.arange(max(math.ceil(self.forecast_s / dt), 1)) + 0.5) * dt
        most = max(self.most_speed_m_s, state.speed_m_s)
        speeds = np.clip(state.speed_m_s + along[:, None] * middles, 0.0, most)
        eased = np.minimum(middles / EASE_S, 1.0)
        bends = memory.curvature_per_m + (curvatures[:, None] - memory.curvature_per_m) * eased
        turned = np.cumsum(bends * speeds * dt, 1)
        headings = state.heading_rad + turned - bends * speeds * dt / 2
        steps = (speeds * dt)[..., None] * np.stack([np.cos(headings), np.sin(headings)], -1)
        return along, curvatures, np.array(state.position_m[:2]) + np.cumsum(steps, 1), headings

    def _costs(self, actor: Actor, places: FloatArray, headings: FloatArray, traffic: Traffic) -> FloatArray:
        """Return the cost (C,) of each drive, in metres."""
        boxes, times = traffic.boxes, np.arange(1, places.shape[1] + 1) * (FORECAST_US / US_PER_SECOND)
        velocity = boxes.speed_m_s * np.stack([boxes.cos, boxes.sin])
        forecast = np.stack([boxes.x_m, boxes.y_m]) + velocity * times[:, None, None]  # (T, 2, N)
        apart = forecast[None] - places[..., None]  # (C, T, 2, N)
        ego = next(index for index, footprint in enumerate(traffic.footprints) if footprint.uid == EGO)
        nearest = np.hypot(apart[:, :, 0, ego], apart[:, :, 1, ego]).min(1)
        others = [index for index, footprint in enumerate(traffic.footprints) if footprint.uid not in (EGO, actor.uid)]
        return np.asarray(
            nearest + self.neighbour_cost_m * _met(actor, apart[..., others], boxes, np.array(others, int))
        )

    def _driven(self, actor: Actor, state: ActorState, memory: AttackMemory, time_us: int, step_us: int) -> ActorMotion:
        """Return the state after a step of the drive that was decided."""
        (x, y, z), heading, speed = state.position_m, state.heading_rad, state.speed_m_s
        turned, way, curvature = 0.0, 0.0, memory.curvature_per_m
        count = -(-step_us // PART_US)
        dt = step_us / count / US_PER_SECOND
        most = max(self.most_speed_m_s, speed)
        for part in range(count):
            since = (time_us - memory.decided_us) / US_PER_SECOND + (part + 0.5) * dt
            curvature = memory.from_per_m + (memory.to_per_m - memory.from_per_m) * min(since / EASE_S, 1.0)
            after = min(max(speed + memory.acceleration_m_s2 * dt, 0.0), most)
            moved = (speed + after) / 2 * dt
            x += moved * math.cos(heading + turned + curvature * moved / 2)
            y += moved * math.sin(heading + turned + curvature * moved / 2)
            turned, way, speed = turned + curvature * moved, way + moved, after
        path = memory.world.paths[actor.uid]
        z += _climb(path, x, y, z, way)
        w, i, j, k = quaternion_product(quaternion_from_yaw(turned), np.array(state.quaternion_wxyz)).tolist()
        acceleration = (speed - state.speed_m_s) * US_PER_SECOND / step_us
        driven = ActorState((x, y, z), (w, i, j, k), speed, acceleration, True)
        return ActorMotion(driven, replace(memory, curvature_per_m=curvature))


def _met(actor: Actor, apart: FloatArray, boxes: FootprintArrays, others: NDArray[np.int64]) -> FloatArray:
    """Return how many boxes (C,) drives meet: those that they lie in at some time, widened by the vehicle's own size."""
    dx, dy = apart[:, :, 0], apart[:, :, 1]  # (C, T, N)
    cos, sin = boxes.cos[others], boxes.sin[others]
    along, across = np.abs(dx * cos + dy * sin), np.abs(dy * cos - dx * sin)
    length, width = float(actor.size_m[0]) / 2, float(actor.size_m[1]) / 2
    inside = (along < boxes.half_length_m[others] + length) & (across < boxes.half_width_m[others] + width)
    return np.asarray(inside.any(1).sum(-1), float)


def _climb(path: ActorPath | None, x: float, y: float, z: float, way_m: float) -> float:
    """Return how far up a vehicle moves on its way, towards the height of its path."""
    if path is None:
        return 0.0
    s, _ = path.project(x, y)
    return min(max(path.place(s)[0][2] - z, -CLIMB * way_m), CLIMB * way_m)
