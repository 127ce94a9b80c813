"""A case of the simulated vehicle: at rest, at 60 m/s, and a million metres from the origin."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Control, Plan
from unisim_blender.core.simulation.vehicle.bicycle import advance
from unisim_blender.core.simulation.vehicle.lqr import track
from unisim_blender.core.simulation.vehicle.parameters import Vehicle

from .measures import Bench, Measure

VEHICLE = Vehicle()
STEP_US = 100_000
RADIUS_M = 1500.0


def _followed(plan: Plan | Callable[[int], Plan], state: EgoState, steps: int) -> list[EgoState]:
    states = [state]
    for step in range(steps):
        now = plan if isinstance(plan, Plan) else plan(step * STEP_US)
        control = track(now, states[-1], VEHICLE, step * STEP_US, STEP_US)
        states.append(advance(states[-1], control, VEHICLE, STEP_US))
    return states


def vehicles(bench: Bench) -> Iterator[Measure]:
    """The bicycle beside its circle, and the tracker back on its path from beside it."""
    seconds = 10 * bench.full
    for speed, steering in ((0.0, 0.5), (1e-9, 1.0), (60.0, 1e-6), (60.0, 0.05), (60.0, 1.0)):
        state = advance(EgoState(0.0, 0.0, 0.0, speed, 0.0, steering), Control(0.0, steering), VEHICLE, seconds * 10**6)
        # beyond what its tyres hold it turns as tightly as they do
        radius = max(VEHICLE.wheelbase_m / math.tan(steering), speed**2 / VEHICLE.max_lateral_acceleration_m_s2)
        half = speed * seconds / radius / 2
        chord = 2 * radius * math.sin(half)
        off = math.hypot(state.x_m - chord * math.cos(half), state.y_m - chord * math.sin(half))
        yield Measure(f"{speed:g} m/s, steering {steering:g}: beside the circle, m", off, 1e-8)
    times = np.arange(0, 8.01, 0.5)
    for speed in (0.0, 60.0):
        for far in (0.0, 1e6):
            plan = Plan(np.round(times * 1e6).astype(np.int64), far + speed * times, far + 0 * times, 0 * times)
            states = _followed(plan, EgoState(far, far + 1.0, 0.02, speed), 60)
            name = f"tracker at {speed:g} m/s, {far:g} m from the origin"
            values = np.array([(s.x_m, s.y_m, s.heading_rad, s.speed_m_s, s.steering_rad) for s in states])
            yield Measure(f"{name}: numbers that are not finite", float((~np.isfinite(values)).sum()), 0)
            if speed == 0:
                yield Measure(f"{name}: moved by, m", float(np.abs(values[:, :4] - values[0, :4]).max()), 0)
                continue
            yield Measure(f"{name}: change of speed, m/s", float(np.abs(values[:, 3] - speed).max()), 0.1)
            yield Measure(f"{name}: beside its path after 6 s, m", abs(values[-1, 1] - far), 0.01)
            yield Measure(f"{name}: past its path, m", float((far - values[:, 1]).max()), 0.1)
    for far in (0.0, 1e6)[bench.full == 1 :]:
        yield from _tracked(far)


def _tracked(far: float) -> Iterator[Measure]:
    """The tracker from 60 m/s to rest and back, on a bend of 2.4 m/s^2 at 60 m/s, and at rest by plans that jitter."""
    where, times = f"{far:g} m from the origin", np.arange(0.0, 34.01, 0.1)
    times_us = np.round(times * 1e6).astype(np.int64)

    def along(distance: FloatArray) -> Plan:
        return Plan(times_us, far + distance, far + 0 * times, 0 * times)

    braking = np.minimum(times, 15.0)
    way = 60 * braking - 2 * braking**2
    states = _followed(along(way), EgoState(far, far + 0.3, 0.0, 60.0), 180)
    yield Measure(f"tracker from 60 m/s to rest, {where}: beside its end, m", abs(states[-1].x_m - far - way[-1]), 0.3)
    late = max(abs(one.x_m - states[-1].x_m) + one.speed_m_s for one in states[-10:])
    yield Measure(f"tracker from 60 m/s to rest, {where}: moved when at rest, m", late, 0)
    states = _followed(along(times**2), EgoState(far, far + 1.0, 0.0, 0.0), 300)
    yield Measure(f"tracker from rest to 60 m/s, {where}: beside its place, m", abs(states[-1].x_m - far - 900.0), 0.01)
    yield Measure(f"tracker from rest to 60 m/s, {where}: beside its path, m", abs(states[-1].y_m - far), 0.01)
    turned = 60 * times / RADIUS_M
    x, y = far + RADIUS_M * np.sin(turned), far + RADIUS_M * (1 - np.cos(turned))
    states = _followed(Plan(times_us, x, y, turned), EgoState(far, far, 0.0, 60.0), 120)
    off = [abs(math.hypot(one.x_m - far, one.y_m - far - RADIUS_M) - RADIUS_M) for one in states]
    yield Measure(f"tracker on a bend at 60 m/s, {where}: beside its path, m", max(off), 0.05)
    yield Measure(f"tracker on a bend at 60 m/s, {where}: the same after 12 s, m", off[-1], 0.001)
    rng = np.random.default_rng(1)

    def jitters(time_us: int) -> Plan:
        x, y = far + rng.normal(0.0, 0.01, (2, 17))
        return Plan(time_us + 250_000 * np.arange(17), x, y, rng.normal(0.0, 0.001, 17))

    states = _followed(jitters, EgoState(far, far, 0.0, 0.0), 50)
    moved = max(math.hypot(one.x_m - far, one.y_m - far) for one in states)
    yield Measure(f"tracker at rest, plans off by 1 cm, {where}: moved by, m", moved, 0)
