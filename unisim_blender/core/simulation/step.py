"""A simulation's context, its start, and its step: from a world and an action to the world a step later.

Start and step are pure functions: the same arguments give the same bits.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..geometry import FloatArray, Quaternion, Vector3
from ..world.captures import US_PER_SECOND
from ..world.drive import Actor, Drive
from .actors.model import ActorModel, ActorMotion, step_all
from .actors.recording import Recording
from .clock import CLOSING_US, SUBSTEP_US, Exposure, key_times
from .states import ActorState, EgoState, Footprint, Traffic, actor_footprint
from .vehicle.actions import Control, Plan
from .vehicle.bicycle import advance, substates
from .vehicle.ground import Heights
from .vehicle.lqr import track
from .vehicle.parameters import Vehicle, footprint_of, state_of
from .world import Action, FollowLog, PoseKey, PoseKeys, World, extended, jumps, recorded_keys

PosesOf = Callable[[Sequence[EgoState]], FloatArray]
"""Gives the poses (N, 4, 4) of the log's ego frame: height, roll and pitch are the ground's."""


@dataclass(frozen=True, eq=False)
class SimulationContext:
    """Where a simulation happens, from ``start_us`` to ``stop_us`` in steps of ``step_us``, integer microseconds.

    ``drive`` is the scenario's, with its edits. ``models`` are the actors' by identifier; ``moved`` names those that the
    simulation moves, the others are where the drive has them. An action takes effect ``delay_us`` after the moment that it
    answers. ``exposures`` are in the order of their ends.
    """

    drive: Drive
    recording: Recording
    vehicle: Vehicle
    poses_of: PosesOf
    heights: Heights
    models: Mapping[str, ActorModel]
    moved: frozenset[str]
    exposures: tuple[Exposure, ...]
    start_us: int
    stop_us: int
    step_us: int
    delay_us: int = 0

    @cached_property
    def standing(self) -> tuple[Footprint, ...]:
        """The boxes of what stands as long as it is recorded and has no model."""
        return tuple(footprint for footprint in self.recording.standing.footprints if footprint.uid not in self.models)

    @cached_property
    def _ends(self) -> list[int]:
        return [exposure.end_us for exposure in self.exposures]

    @cached_property
    def _longest_us(self) -> int:
        return max((exposure.end_us - exposure.start_us for exposure in self.exposures), default=0)

    def ended(self, after_us: int, until_us: int) -> list[Exposure]:
        """Return the exposures that end after one time and not after another."""
        first, last = (bisect_left(self._ends, time_us + 1) for time_us in (after_us, until_us))
        return list(self.exposures[first:last])

    def during(self, start_us: int, stop_us: int) -> list[Exposure]:
        """Return the exposures of which some part lies between two times."""
        first, last = bisect_left(self._ends, start_us), bisect_left(self._ends, stop_us + self._longest_us + 1)
        return [exposure for exposure in self.exposures[first:last] if exposure.start_us <= stop_us]


SPEED_S = 0.1
"""Recorded speeds and yaw rates are means over so long."""
CREEPING_M_S = 0.5
"""Slower vehicles' steering angles do not follow from how they turn."""
BACK_S = 10.0


def start(context: SimulationContext, drives: bool, ego: EgoState | None = None) -> World:
    """Return the world at the start of a simulation.

    ``drives``: whether the vehicle may leave its recorded trajectory. ``ego`` is where it starts in place of where it was
    recorded; it then arrives there straight on, at its speed.
    """
    time_us = context.start_us
    time_s = time_us / US_PER_SECOND
    keys: PoseKeys = ()
    begins = recorded_ego(context, time_us) if ego is None else ego
    if drives:
        trajectory = context.drive.world_from_ego
        if ego is None:
            keys = (*recorded_keys(trajectory, None, time_s), PoseKey.on(trajectory, time_us))
        else:
            back_us = time_us - round(BACK_S * US_PER_SECOND)
            away = begins.speed_m_s * BACK_S
            before = replace(
                begins,
                x_m=begins.x_m - away * math.cos(begins.heading_rad),
                y_m=begins.y_m - away * math.sin(begins.heading_rad),
            )
            poses = context.poses_of([before, begins])
            keys = tuple(PoseKey.all_of([back_us, time_us], poses))
    motions = {
        uid: model.start(context.drive.actors[uid], context.recording, time_us) for uid, model in context.models.items()
    }
    recorded = {uid: context.drive.actors[uid].world_from_actor for uid in sorted(context.moved)}
    return World(
        time_us,
        begins,
        traffic_of(context, time_us, begins, motions),
        motions,
        FollowLog() if not drives else Control(0.0, begins.steering_rad),
        ego_keys=extended(keys, (), time_us, carries=True),
        keys={
            uid: (*recorded_keys(trajectory, time_s - BACK_S, time_s), PoseKey.on(trajectory, time_us))
            for uid, trajectory in recorded.items()
        },
    )


def step(world: World, action: Action, context: SimulationContext) -> World:
    """Return the world a step later, or at the end of the simulation.

    ``action`` answers the moment of ``world``; it takes effect at the first step that begins its delay later or after that.
    """
    if context.delay_us > 0:
        return enqueue_action(advance_world(world, context), action, world.time_us, context)
    return advance_world(enqueue_action(world, action, world.time_us, context), context)


def enqueue_action(world: World, action: Action, asked_us: int, context: SimulationContext) -> World:
    """Return the world with a driver's answer to the moment ``asked_us`` among its pending actions."""
    return replace(world, pending=(*world.pending, (asked_us + context.delay_us, action)))


def advance_world(world: World, context: SimulationContext) -> World:
    """Return the world a step later, or at the end of the simulation, by the answers that it has."""
    now, later = world.time_us, min(world.time_us + context.step_us, context.stop_us)
    pending = world.pending
    due = [answer for time_us, answer in pending if time_us <= now]
    action: Action = due[-1] if due else world.action
    during = context.during(now, later)
    ego, new_keys = _drive(world, action, context, later, during)
    motions = step_all(context.models, context.drive.actors, world.motions, world.traffic, now, later - now)
    strayed, vanished = set(world.strayed), dict(world.vanished_s)
    closes = any(exposure.end_us == later for exposure in during)
    recorded = context.recording.poses_at(later / US_PER_SECOND)
    closing = context.recording.poses_at((later + CLOSING_US) / US_PER_SECOND) if closes else {}
    keys = {}
    for uid in sorted(context.moved):
        state = motions[uid].state
        # to the bit
        if uid not in strayed and (state.position_m, state.quaternion_wxyz) != recorded[uid]:
            strayed.add(uid)
        if uid in strayed and not state.present:
            vanished.setdefault(uid, later / US_PER_SECOND)
        close = None if not closes else _moved_on(state) if uid in strayed else closing[uid]
        of_step = _actor_keys(context.drive.actors[uid], state, now, later, close, uid in strayed)
        keys[uid] = extended(world.keys[uid], of_step, later)
    return World(
        later,
        ego,
        traffic_of(context, later, ego, motions),
        motions,
        action,
        tuple(answer for answer in pending if answer[0] > now),
        extended(world.ego_keys, new_keys, later, carries=True) if world.ego_keys else (),
        keys,
        frozenset(strayed),
        vanished,
    )


def recorded_ego(context: SimulationContext, time_us: int) -> EgoState:
    """Return the ego vehicle's recorded state at a time: speed, acceleration and steering angle are those of its path: of
    the one from the simulation's start on, where it jumps there."""
    vehicle, time_s = context.vehicle, time_us / US_PER_SECOND
    times = time_s + SPEED_S * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    first_s, last_s = context.drive.world_from_ego.times_s[[0, -1]]
    start_s = context.start_us / US_PER_SECOND
    times = np.clip(times, start_s if jumps(context.drive.world_from_ego, start_s) else first_s, last_s)
    poses = context.drive.world_from_ego.at(times)
    states = [state_of(pose, vehicle)[0] for pose in poses]
    first, _, here, _, last = states
    span = times[-1] - times[0]
    if span <= 0:
        return here

    def along(a: EgoState, b: EgoState) -> float:
        return (b.x_m - a.x_m) * math.cos(here.heading_rad) + (b.y_m - a.y_m) * math.sin(here.heading_rad)

    speed = along(first, last) / span
    before, after = times[2] - times[0], times[4] - times[2]
    acceleration = 0.0
    if before > 0 and after > 0:
        acceleration = (along(here, last) / after - along(first, here) / before) / (span / 2)
    turning = math.remainder(last.heading_rad - first.heading_rad, math.tau) / span
    steering = math.atan(vehicle.wheelbase_m * turning / speed) if speed > CREEPING_M_S else 0.0
    limit = vehicle.max_steering_rad
    return replace(
        here, speed_m_s=max(speed, 0.0), acceleration_m_s2=acceleration, steering_rad=min(max(steering, -limit), limit)
    )


def traffic_of(context: SimulationContext, time_us: int, ego: EgoState, motions: Mapping[str, ActorMotion]) -> Traffic:
    """Return everything that is present at a time, seen from above: the ego vehicle first."""
    moving = [footprint_of(ego, context.vehicle)]
    for uid, motion in motions.items():
        if motion.state.present:
            moving.append(actor_footprint(context.drive.actors[uid], motion.state))
    return Traffic(time_us, (*moving, *context.standing))


def _drive(
    world: World, action: Action, context: SimulationContext, later: int, during: list[Exposure]
) -> tuple[EgoState, list[PoseKey]]:
    """Return the vehicle's state at the end of a step, and the keys that it gets during it."""
    now = world.time_us
    trajectory = context.drive.world_from_ego
    if isinstance(action, FollowLog):
        ego = recorded_ego(context, later)
        if not world.ego_keys:
            return ego, []
        times = key_times(now, later, during)
        own = recorded_keys(trajectory, now / US_PER_SECOND, later / US_PER_SECOND)
        keys = [*own, *(PoseKey.of(time_us, trajectory.at(time_us / US_PER_SECOND)) for time_us in times)]
        return ego, sorted({key.time_s: key for key in keys}.values(), key=lambda key: key.time_s)
    control = track(action, world.ego, context.vehicle, now, later - now) if isinstance(action, Plan) else action
    states = {now: world.ego}
    for after_us, state in substates(world.ego, control, context.vehicle, later - now):
        states[now + after_us] = state
    times = key_times(now, later, during)
    for time_us in times:
        if time_us not in states:  # the grid's states do not depend on when sensors look
            before = later if time_us > later else now + (time_us - now) // SUBSTEP_US * SUBSTEP_US
            states[time_us] = advance(states[before], control, context.vehicle, time_us - before)
    return states[later], _keys_of(world, [(time_us, states[time_us]) for time_us in times], context)


def _keys_of(world: World, states: list[tuple[int, EgoState]], context: SimulationContext) -> list[PoseKey]:
    """Return the vehicle's keys in states at times, integer microseconds. Where it stands they have the same pose, to the
    bit: from step to step, too."""
    time_s = world.time_us / US_PER_SECOND
    known = {_place(world.ego): key for key in world.ego_keys if key.time_s == time_s}
    new = {_place(state): state for _, state in states if _place(state) not in known}
    poses = context.poses_of(list(new.values()))
    known |= dict(zip(new, PoseKey.all_of([0] * len(new), poses), strict=True))
    return [replace(known[_place(state)], time_s=time_us / US_PER_SECOND) for time_us, state in states]


def _place(state: EgoState) -> tuple[float, float, float]:
    return state.x_m, state.y_m, state.heading_rad


def _actor_keys(
    actor: Actor, state: ActorState, now: int, later: int, close: tuple[Vector3, Quaternion] | None, strayed: bool
) -> Iterator[PoseKey]:
    """Yield the keys that an actor gets during a step: one at its end, the recorded ones while it has not strayed, and one that
    closes an exposure, at ``close``."""
    if not strayed:
        yield from recorded_keys(actor.world_from_actor, now / US_PER_SECOND, later / US_PER_SECOND)
    yield PoseKey(later / US_PER_SECOND, state.position_m, state.quaternion_wxyz)
    if close is not None:
        yield PoseKey((later + CLOSING_US) / US_PER_SECOND, *close)


def _moved_on(state: ActorState) -> tuple[Vector3, Quaternion]:
    """Return where an actor is when an exposure is closed, at its velocity."""
    ahead = state.speed_m_s * CLOSING_US / US_PER_SECOND
    x, y, z = state.position_m
    place = (x + ahead * math.cos(state.heading_rad), y + ahead * math.sin(state.heading_rad), z)
    return place, state.quaternion_wxyz
