"""A case of the Intelligent Driver Model, as an actor's model and as a driver: at rest, at 60 m/s, and a million metres off."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from recorded_traffic import EgoAt, actor, ego_box, footprint, keys, recording, run, standing, straight

from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.simulation.actors.models.idm import Idm
from unisim_blender.core.simulation.drivers.builtin import IdmDriver
from unisim_blender.core.simulation.drivers.driver import DriverSetup, EgoMotion, Observation
from unisim_blender.core.simulation.states import EgoState, Traffic
from unisim_blender.core.simulation.vehicle.bicycle import advance
from unisim_blender.core.simulation.vehicle.lqr import track
from unisim_blender.core.simulation.vehicle.parameters import Vehicle, footprint_of

from .measures import Bench, Measure

MODEL, VEHICLE = Idm(), Vehicle()
FAST = 60.0
HALF_LENGTHS = (4.5 + 4.8) / 2
"""Of the follower's box and the lead's."""
STEP_US = 100_000


def followers(bench: Bench) -> Iterator[Measure]:
    """An actor beside its equation, and the driver in a loop with tracker and vehicle, behind what stands and what drives."""
    seconds = 25.0 if bench.full == 1 else 60.0
    for far in (0.0, 1e6)[bench.full == 1 :]:
        yield from _actors(far, seconds)
        yield from _driver(far, seconds)


def _actors(far: float, seconds: float) -> Iterator[Measure]:
    where, times = f"{far:g} m off", keys(seconds)
    waits = straight(times, far, far, np.where(times < 1.0, 0.0, 10.0))
    for gap in (1.0, 0.2):
        moved, _ = _followed(waits, _at(far, HALF_LENGTHS + gap, 0.0), seconds)
        yield Measure(f"actor at rest, {gap:g} m behind a box, {where}: moved by, m", float(moved[-1] - far), 2e-3)
    fast = straight(times, far, far, FAST)
    _, speeds = _followed(fast, _at(far, 1e5, FAST), seconds)
    yield Measure(f"actor alone at 60 m/s, {where}: change of speed, m/s", float(np.abs(speeds - FAST).max()), 1e-6)
    places, speeds = _followed(fast, _at(far, HALF_LENGTHS + 300.0, 0.0), seconds)
    rest = 300.0 + far - float(places[-1])
    yield Measure(f"actor from 60 m/s to a box, {where}: beside its gap at rest, m", abs(rest - MODEL.gap_m), 0.1)
    yield Measure(f"actor from 60 m/s to a box, {where}: speed at the end, m/s", float(speeds[-1]), 0.02)
    places, speeds = _followed(fast, _at(far, HALF_LENGTHS + 150.0, 50.0), seconds)
    s, v = _equation(FAST, 150.0, 50.0, seconds)
    off = float(np.abs(places - far - s).max())
    yield Measure(f"actor at 60 m/s behind 50 m/s, {where}: beside its equation, m", off, 0.5)
    yield Measure(f"the same, {where}: speed beside its equation, m/s", float(np.abs(speeds - v).max()), 0.2)


def _at(far: float, ahead_m: float, speed: float) -> EgoAt:
    return lambda time_us: ego_box(far + ahead_m + speed * time_us / 1e6, far, speed)


def _followed(recorded: Trajectory, lead: EgoAt, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Places along x and speeds (T,) of an actor behind a lead."""
    world = recording(recorded, actor("f", recorded), seconds=seconds)
    found = run(world, {"f": MODEL}, lead, seconds, STEP_US)
    return found.column("f", "x"), found.column("f", "speed_m_s")


def _equation(speed: float, gap: float, lead: float, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Distances and speeds (T,) every step by Runge and Kutta's method, steps of 1 ms: the model's equation, with the limits
    that `advanced` states."""
    a, b = MODEL.acceleration_m_s2, MODEL.braking_m_s2

    def change(t: float, s: float, v: float) -> tuple[float, float]:
        free = max(a * (1 - (v / FAST) ** MODEL.exponent), -b)
        wanted = MODEL.gap_m + max(v * MODEL.headway_s + v * (v - lead) / (2 * math.sqrt(a * b)), 0.0)
        return v, max(free - a * (wanted / (gap + lead * t - s)) ** 2, -8.0)

    dt, t, s, v = 1e-3, 0.0, 0.0, speed
    rows = [(s, v)]
    for number in range(1, round(seconds / dt) + 1):
        ds1, dv1 = change(t, s, v)
        ds2, dv2 = change(t + dt / 2, s + dt / 2 * ds1, v + dt / 2 * dv1)
        ds3, dv3 = change(t + dt / 2, s + dt / 2 * ds2, v + dt / 2 * dv2)
        ds4, dv4 = change(t + dt, s + dt * ds3, v + dt * dv3)
        s += dt * (ds1 + 2 * ds2 + 2 * ds3 + ds4) / 6
        v += dt * (dv1 + 2 * dv2 + 2 * dv3 + dv4) / 6
        t += dt
        if number % round(STEP_US / 1e6 / dt) == 0:
            rows.append((s, v))
    distances, speeds = np.array(rows).T
    return distances, speeds


def _driver(far: float, seconds: float) -> Iterator[Measure]:
    where, front_m = f"{far:g} m off", VEHICLE.length_m - VEHICLE.rear_overhang_m
    for speed, gap in ((0.0, MODEL.gap_m), (FAST, 300.0)):
        states = _driven(far, speed, far + front_m + gap + 2.25, seconds)
        x, y, v = (np.array([getattr(one, name) for one in states]) for name in ("x_m", "y_m", "speed_m_s"))
        name = f"driver from {speed:g} m/s, {gap:g} m behind a box, {where}"
        if speed == 0:
            yield Measure(f"{name}: moved by, m", float(np.abs(x - far).max()), 0.01)
            continue
        yield Measure(f"{name}: beyond the gap at rest, m", abs(far + gap - float(x[-1]) - MODEL.gap_m), 0.6)
        yield Measure(f"{name}: speed at the end, m/s", float(v[-1]), 0.05)
        yield Measure(f"{name}: beside its path, m", float(np.abs(y - far).max()), 1e-6)
    states = _driven(far, FAST, far + 1e6, seconds)
    changed = max(abs(one.speed_m_s - FAST) for one in states)
    yield Measure(f"driver alone at 60 m/s, {where}: change of speed, m/s", changed, 0.01)
    yield Measure(f"the same, {where}: beside its path, m", max(abs(one.y_m - far) for one in states), 1e-6)


def _driven(far: float, speed: float, wall_m: float, seconds: float) -> list[EgoState]:
    """States of the vehicle at each step: the driver's plans, tracked; a box stands with its middle at ``wall_m``."""
    wall = actor("wall", standing(wall_m, far))
    times = keys(seconds)
    world = recording(straight(times, far, far, max(speed, 1.0)), wall, seconds=seconds)
    driver = IdmDriver(DriverSetup(VEHICLE, {}, np.zeros((2, 2)), STEP_US, 0, 0, recording=world))
    stands = footprint(wall, world.state("wall", 0))
    states = [EgoState(far, far, 0.0, speed)]
    for time_us in range(0, round(seconds * 1e6), STEP_US):
        state = states[-1]
        traffic = Traffic(time_us, (footprint_of(state, VEHICLE), stands))
        plan = driver.drive(Observation(time_us, (), (), (EgoMotion(time_us, state),), traffic))
        states.append(advance(state, track(plan, state, VEHICLE, time_us, STEP_US), VEHICLE, STEP_US))
    return states
