"""Nothing jumps: in random scenes no box moves further in a step than its speed allows, whatever its model."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_traffic import PERSON, actor, bend, ego_box, jumps, keys, recording, run, standing, straight

from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.simulation.actors import Attack, Auto, CutIn, Idm, Lane, Model, Replay, Scripted
from unisim_blender.core.simulation.actors.models.scripted import ScriptedKey
from unisim_blender.core.simulation.states import Footprint

SECONDS = 8.0
WINDOW_M = 0.05
"""A recorded speed is a mean over half a second: with up to 2 m/s² a box moves this much further in a step of 0.1 s."""


def of_speeds(rng: np.random.Generator) -> FloatArray:
    """A speed at each key: smooth, at times standing."""
    times = keys(SECONDS)
    start, change = rng.uniform(0, 14), rng.uniform(-2, 2)
    return np.clip(start + change * times, 0, 15)


def trajectory(rng: np.random.Generator) -> Trajectory:
    """Straight at a changing speed, or a bend, or standing."""
    x, y, heading = rng.uniform(-40, 60), rng.uniform(-8, 8), rng.choice([0.0, 0.0, math.pi, math.pi / 2, 0.3])
    kind = rng.integers(5)
    if kind == 0:
        return standing(x, y, heading)
    if kind == 1:
        return bend(keys(SECONDS), x, y, rng.uniform(2, 12), rng.uniform(0.02, 0.3) * rng.choice([-1, 1]), heading)
    whole = straight(keys(SECONDS), x, y, of_speeds(rng), heading)
    first, end = sorted(rng.choice(len(whole.times_s), 2, replace=False).tolist()) if kind == 2 else (0, 80)
    part = slice(first, max(end, first + 2) + 1)
    return Trajectory(whole.times_s[part], whole.positions[part], whole.quaternions_wxyz[part])


@given(st.integers(0, 2**32 - 1), st.sampled_from([50_000, 100_000, 250_000]))
@settings(max_examples=25, deadline=None)
def test_nothing_jumps(seed: int, step_us: int) -> None:
    rng = np.random.default_rng(seed)
    kinds: list[Model] = [
        Idm(), Auto(), Lane(), CutIn(cut_in_headway_s=4.0), Attack(), Replay(),
        Scripted((ScriptedKey(2.0, speed_m_s=6.0), ScriptedKey(5.0, speed_m_s=0.0))),
    ]  # fmt: skip
    actors = [actor(f"a{index}", trajectory(rng)) for index in range(8)]
    actors += [actor("person", trajectory(rng), "Pedestrian", PERSON)]
    world = recording(straight(keys(SECONDS), 0, 0, of_speeds(rng)), *actors, seconds=SECONDS, seed=seed)
    models = {one.uid: kinds[rng.integers(len(kinds))] for one in actors}
    speed, aside, drift = rng.uniform(0, 12), rng.uniform(-4, 4), rng.uniform(-0.5, 0.5)

    def ego(time_us: int) -> Footprint:
        t = time_us / 1e6
        return ego_box(speed * t, aside + drift * t, speed)

    result = run(world, models, ego, SECONDS + 2, step_us)
    for uid in models:
        assert np.isfinite(result.column(uid, "speed_m_s")).all() and (result.column(uid, "speed_m_s") >= 0).all()
        over = jumps(result, uid)
        assert len(over) == 0 or over.max() < WINDOW_M * step_us / 100_000 + 0.02, (uid, models[uid].type, over.max())
        headings = np.unwrap([state.heading_rad for state in result.states(uid)])
        assert np.abs(np.diff(headings)).max() < 0.2 * 15 * step_us / 1e6 + 0.1, (uid, models[uid].type)
