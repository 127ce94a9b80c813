"""The model `scripted`."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ....geometry import quaternion_from_yaw, quaternion_product
from ....scenario.json_schema import Schema, SchemaOf, object_of
from ....world.actor_path import ActorPath, joined, quintic
from ....world.captures import US_PER_SECOND
from ....world.drive import Actor
from ...states import ActorState, Traffic
from ..model import ActorMotion, Model, Speed, register
from ..recording import Recording
from .idm import RETURN_M

MOST_TURN_RAD = 0.5
"""Largest turn of an actor going aside, radians: a vehicle moved aside while standing does not turn on the spot."""


@dataclass(frozen=True)
class ScriptedKey:
    """State that an actor has reached at a time: a speed, or how far left of its path it is, or both."""

    time_s: Annotated[float, SchemaOf({"type": "number", "minimum": -1e6, "maximum": 1e6})]
    speed_m_s: Speed | None = None
    left_m: Annotated[float, SchemaOf({"type": "number", "minimum": -100, "maximum": 100})] | None = None


KEYS: Schema = {"type": "array", "items": object_of(ScriptedKey), "minItems": 1, "maxItems": 1000}
TimedValues = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class ScriptMemory:
    """Memory of a scripted actor: the path that it is on from ``first_s`` on, and its speeds and distances to the left by time.

    ``path`` is None where the speeds are the recorded ones.
    """

    world: Recording
    first_s: float
    path: ActorPath | None
    speeds: TimedValues
    lefts: TimedValues


@register
@dataclass(frozen=True)
class Scripted(Model):
    """Along its recorded path by keys of speed and of distance to the left, whatever is in its way.

    Speeds are linear between their keys, from the recorded one at the start; with no key of speed they are the recorded ones.
    Distances to the left are quintics between their keys, from 0 at the start. Beyond the last key both stay.
    """

    type = "scripted"

    keys: Annotated[tuple[ScriptedKey, ...], SchemaOf(KEYS)]

    def check(self) -> None:
        for index, key in enumerate(self.keys):
            if key.speed_m_s is None and key.left_m is None:
                self.fail(f"keys[{index}]", "needs speed_m_s or left_m")
            if index and key.time_s <= self.keys[index - 1].time_s:
                self.fail(f"keys[{index}].time_s", f"{key.time_s:g} must be later than {self.keys[index - 1].time_s:g}")

    def start(self, actor: Actor, world: Recording, time_us: int) -> ActorMotion:
        """Return the state at the start: by keys that lie before it, or else as recorded."""
        first_s = max(time_us / US_PER_SECOND, world.windows_s[actor.uid][0])
        recorded = world.state_at(actor.uid, first_s)
        speeds: TimedValues = tuple((key.time_s, key.speed_m_s) for key in self.keys if key.speed_m_s is not None)
        lefts: TimedValues = tuple((key.time_s, key.left_m) for key in self.keys if key.left_m is not None)
        path = None
        if speeds:
            path = _path(actor, world, recorded, first_s)
            if speeds[0][0] > first_s:
                speeds = ((first_s, recorded.speed_m_s), *speeds)
        if lefts and lefts[0][0] > first_s:
            lefts = ((first_s, 0.0), *lefts)
        script = ScriptMemory(world, first_s, path, speeds, lefts)
        return ActorMotion(_state(actor, script, time_us), script)

    def answer(self, actor: Actor, motion: ActorMotion, traffic: Traffic, time_us: int, step_us: int) -> ActorMotion:
        """Return the state at the end of the step, which depends on the time alone."""
        script = motion.memory
        assert isinstance(script, ScriptMemory)
        return replace(motion, state=_state(actor, script, time_us + step_us))


def _path(actor: Actor, world: Recording, recorded: ActorState, first_s: float) -> ActorPath:
    """Return the path from the recorded place; straight ahead for an actor that stands in the recording."""
    path = world.continued(actor.uid)
    if path is None:
        path = ActorPath.straight(recorded.position_m, recorded.heading_rad)
    s = path.s_at_time(first_s) if len(path.arrivals_s) else 0.0
    return joined(path, s, recorded.position_m, recorded.quaternion_wxyz, RETURN_M)


def _state(actor: Actor, script: ScriptMemory, time_us: int) -> ActorState:
    now = time_us / US_PER_SECOND
    if script.path is None or now < script.first_s:
        state = script.world.state(actor.uid, time_us)
    else:
        s, speed, acceleration = _driven(script.speeds, script.first_s, now)
        position, quaternion = script.path.place(s)
        state = ActorState(position, quaternion, speed, acceleration, True)
    return _aside(state, *_left(script.lefts, now)) if script.lefts else state


def _driven(keys: TimedValues, first_s: float, now_s: float) -> tuple[float, float, float]:
    """Return the way since ``first_s``, the speed and the acceleration: speeds are linear between keys and stay beyond them."""
    times, speeds = (np.array(part) for part in zip(*keys, strict=True))
    inner = times[(times > first_s) & (times < now_s)]
    at = np.concatenate([[first_s], inner, [now_s]])
    values = np.interp(at, times, speeds)
    way = float(np.sum((values[1:] + values[:-1]) / 2 * np.diff(at)))
    upper = int(np.searchsorted(times, now_s, side="right"))
    inside = 0 < upper < len(times)
    slope = (speeds[upper] - speeds[upper - 1]) / (times[upper] - times[upper - 1]) if inside else 0.0
    return way, float(values[-1]), float(slope)


def _left(keys: TimedValues, now_s: float) -> tuple[float, float]:
    """Return the distance to the left and its change by time: quintics between keys, at rest at each."""
    times, lefts = zip(*keys, strict=True)
    upper = bisect_right(times, now_s)
    if not 0 < upper < len(times):
        return lefts[0 if upper == 0 else -1], 0.0
    lasts = times[upper] - times[upper - 1]
    change = lefts[upper - 1] - lefts[upper]
    value, slope = quintic(np.array((now_s - times[upper - 1]) / lasts), change, 0.0)
    return lefts[upper] + float(value), float(slope) / lasts


def _aside(state: ActorState, left_m: float, rate_m_s: float) -> ActorState:
    """Return a state moved to the left, turned into the direction in which it then goes."""
    x, y, z = state.position_m
    heading = state.heading_rad
    turn = math.atan2(rate_m_s, state.speed_m_s) if rate_m_s else 0.0
    turn = min(max(turn, -MOST_TURN_RAD), MOST_TURN_RAD)
    w, i, j, k = quaternion_product(quaternion_from_yaw(turn), np.array(state.quaternion_wxyz)).tolist()
    position = x - left_m * math.sin(heading), y + left_m * math.cos(heading), z
    speed = math.hypot(state.speed_m_s, rate_m_s)
    return replace(state, position_m=position, quaternion_wxyz=(w, i, j, k), speed_m_s=speed)
