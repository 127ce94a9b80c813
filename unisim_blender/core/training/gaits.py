"""Which actors change their shape as they go, and the metres of path in a cycle of each one's gait."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..data.log import Log, extras_of
from ..geometry import FloatArray, invert_pose, transform_points
from ..world.classes import motion_of
from ..world.drive import Actor
from .batches.data import lidar_captures

CRANK_TURN_M, RIDING_M_S = 4.6, 2.6
"""Metres that a bicycle goes in a turn of its crank, in a middle gear; the speed above which one rides."""
WALK_RATIO = 0.39
"""Length of a step, squared, over speed, seconds metres: Sekiya and Nagasaki, 1998, have .0065 m in a step a minute."""
_MIN_CYCLES, _MIN_RETURNS, _MIN_SWEEPS = 0.5, 15, 12
_RATIOS = np.geomspace(0.7, 1.45, 91)
"""Cycles that are tried, relative to what the speed tells."""
_MIN_GAIN = 0.08
"""Part of the misfit that another cycle must explain."""


def gaits_of(log: Log, lidars: Sequence[str], frames: Sequence[int]) -> tuple[tuple[str, float], ...]:
    """Return the ids of actors with a gait, ascending, and the metres in a cycle: as the LiDAR's returns from their legs repeat,
    or where these are too few as walkers of their speed do. Whoever goes less than half a cycle has none."""
    classes, expected = extras_of(log).classes, {}
    for uid, actor in sorted(log.drive.actors.items()):
        keys = actor.world_from_actor
        if actor.is_moving and len(keys.times_s) > 1 and motion_of(actor.label, classes) == "deforming":
            way_m = float(keys.walked_m[-1])
            speed = way_m / float(keys.times_s[-1] - keys.times_s[0])
            cycle_m = CRANK_TURN_M if speed > RIDING_M_S else 2 * float(np.sqrt(WALK_RATIO * speed))
            if way_m > _MIN_CYCLES * cycle_m:
                expected[uid] = cycle_m
    legs: dict[str, list[tuple[float, FloatArray]]] = {uid: [] for uid in expected}
    for name, frame in lidar_captures(log, lidars, frames) if expected else ():
        sweep = log.sweep(name, frame)
        for uid in expected:
            seen = _legs(log.drive.actors[uid], sweep.points, sweep.time_s)
            if seen is not None:
                legs[uid].append(seen)
    return tuple((uid, round(_fitted(cycle_m, legs[uid]), 4)) for uid, cycle_m in expected.items())


def _legs(actor: Actor, points: FloatArray, time_s: FloatArray) -> tuple[float, FloatArray] | None:
    """Return the length of an actor's path when a sweep hits its lower half, and where along it the returns lie: parts (12,)
    of them. None where few do."""
    keys = actor.world_from_actor
    near = np.flatnonzero(
        np.abs(points - keys.positions_at(float(np.median(time_s)))).max(1) < actor.size_m.max() / 2 + 2.0
    )
    if len(near) < _MIN_RETURNS:
        return None
    time = float(np.median(time_s[near]))
    if not actor.present(time):
        return None
    local = transform_points(invert_pose(keys.at(time)), points[near]) / actor.size_m
    inside = (np.abs(local) < [0.55, 0.55, 0.5]).all(1) & (local[:, 2] > -0.46) & (local[:, 2] < 0.0)
    if inside.sum() < _MIN_RETURNS:
        return None
    counts, _ = np.histogram(local[inside, 0], 12, (-0.55, 0.55))
    return float(keys.walked_at(time)), counts / counts.sum()


def _fitted(cycle_m: float, legs: Sequence[tuple[float, FloatArray]]) -> float:
    """Return the cycle, near one, at which the legs' places repeat best."""
    if len(legs) < _MIN_SWEEPS:
        return cycle_m
    walked, places = np.array([way for way, _ in legs]), np.stack([place for _, place in legs])
    # where it is seen from changes, too
    trend = np.vander((walked - walked.mean()) / np.ptp(walked), 3)

    def misfit(cycle_m: float) -> float:
        angle = 2 * np.pi * walked[:, None] / cycle_m
        waves = np.concatenate([trend, *(f(n * angle) for n in (1, 2) for f in (np.cos, np.sin))], 1)
        rest = places - waves @ np.linalg.lstsq(waves, places, rcond=None)[0]
        return float((rest**2).sum() + 1e-6 * (places**2).sum())

    tried = cycle_m * _RATIOS
    misfits = np.array([misfit(float(cycle)) for cycle in tried])
    best = int(misfits.argmin())
    # a misfit that still falls at an end of what is tried is a trend, not a gait
    repeats = 0 < best < len(tried) - 1 and misfits[best] < (1 - _MIN_GAIN) * misfit(cycle_m)
    return float(tried[best]) if repeats else cycle_m
