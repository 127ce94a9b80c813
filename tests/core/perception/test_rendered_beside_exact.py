"""The benchmark's tables: paired differences, intervals, and how far two trajectories are apart, against hand-worked cases."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3]))

from benchmarks.rendered_beside_exact.__main__ import kinds_of
from benchmarks.rendered_beside_exact.loops import JITTER, LEADS, START_S, lead_of
from benchmarks.rendered_beside_exact.noise import noisy
from benchmarks.rendered_beside_exact.streets import EVERY, sparse, street_of_seed
from benchmarks.rendered_beside_exact.tables import apart_of, bootstrap, lines, metrics_of
from unisim_blender.core.simulation.drivers.driver import POINT_FIELDS


def loop(x: list[float], collisions: int, pdms: float | None) -> dict[str, Any]:
    times = [1.0 + number for number in range(len(x))]
    scores = dict.fromkeys(("hd_score", "minimum_ttc_s", "progress", "driven_m", "unsupported"), 0.5)
    counts = {"collisions": collisions, "collisions_at_fault": 0}
    return {
        "time_s": times, "x_m": x, "y_m": [0.0] * len(x), "speed_m_s": [1.0] * len(x),
        "lead": "stops", "scores": {**scores, **counts, "pdms": pdms}, "processor_s": 1.0,
    }  # fmt: skip


def result(offset: float, collisions: tuple[int, int] = (0, 0), pdms: tuple[float | None, float] = (0.5, 0.5)) -> Any:
    straight = [0.0, 10.0, 20.0]
    away = [x + offset * number for number, x in enumerate(straight)]
    return {"rendered": loop(away, collisions[0], pdms[0]), "exact": loop(straight, collisions[1], pdms[1])}


def test_how_far_apart() -> None:
    times, apart = apart_of(result(-0.5))
    assert times.tolist() == [0.0, 1.0, 2.0] and apart.tolist() == [0.0, 0.5, 1.0]
    apart_m = metrics_of([result(offset) for offset in (0.0, 1.0, -2.0)])["apart_m"]
    assert list(apart_m) == ["1", "2"]  # no longer than the loops are
    assert apart_m["2"]["quantiles"]["0.5"] == 2.0 and apart_m["2"]["greatest"] == 4.0
    by_lead = metrics_of([result(offset) for offset in (0.0, 1.0, -2.0)])["at_the_end_by_lead_m"]
    assert by_lead == {"stops": apart_m["2"]}
    low, high = apart_m["2"]["median_interval"]
    assert 0.0 <= low < 2.0 < high <= 4.0


def test_differences_are_of_pairs() -> None:
    """A collision in one loop is a rollout with a collision, however many there were; a score that is missing takes its pair
    along."""
    results = [result(0, (2, 0)), result(0, (0, 0)), result(0, (1, 1)), result(0, (0, 0), (None, 1.0))]
    scores = metrics_of(results)["scores"]
    assert scores["collides"]["rendered"] == 0.5 and scores["collides"]["exact"] == 0.25
    assert scores["collides"]["difference"] == 0.25 and scores["collides"]["interval"] == [0.0, 0.75]
    assert scores["pdms"] == {"pairs": 3, "rendered": 0.5, "exact": 0.5, "difference": 0.0, "interval": [0.0, 0.0]}
    assert any(
        line.startswith("| rollouts with a collision | 0.500 | 0.250 | +0.250") for line in lines(metrics_of(results))
    )


def test_loops_on_other_noise_are_compared_alike() -> None:
    """Exact sensors without noise beside one draw of it, or two draws beside each other; each has a file of its own."""
    (one, other), name = kinds_of(0.01, 1)
    assert (one.name, other.name, name) == ("exact, 0.01 m of noise, draw 1", "exact", "metrics-noise-0.01m-1.json")
    (one, other), name = kinds_of(1e-6, 2)
    assert (one.draw, other.draw, name) == (1, 2, "metrics-noise-1e-06m-2.json")
    paths = {
        unit.path(Path()) for noise in (None, 0.01, 1e-6) for draws in (1, 2) for unit in kinds_of(noise, draws)[0]
    }
    assert len(paths) == 6
    pair = {unit.name: loop for unit, loop in zip((one, other), result(1.0).values(), strict=True)}
    found = metrics_of([pair])
    assert found["apart_m"]["2"]["greatest"] == 2.0 and set(found["processor_s"]) == {one.name, other.name}
    assert f"| | {one.name} | {other.name} | difference | pairs |" in lines(found)


def test_noise_is_along_the_rays_and_follows_from_its_seed() -> None:
    rng, points = np.random.default_rng(2), np.zeros(20_000, POINT_FIELDS)
    rays = rng.normal(size=(len(points), 3))
    rays *= (rng.uniform(5, 60, len(points)) / np.linalg.norm(rays, axis=1))[:, None]
    points["x"], points["y"], points["z"] = rays.T
    points["intensity"] = 0.5
    found = noisy(points, 0.01, (0, 4, 1, 200_000))
    moved = np.stack([found[axis].astype(float) - points[axis] for axis in "xyz"], -1)
    along = (moved * rays).sum(1) / np.linalg.norm(rays, axis=1)
    assert along.std() == pytest.approx(0.01, rel=0.02) and abs(along.mean()) < 3e-4
    assert np.abs(np.linalg.norm(moved, axis=1) - np.abs(along)).max() < 1e-5  # float32
    assert (found["intensity"] == points["intensity"]).all()
    assert found.tobytes() == noisy(points, 0.01, (0, 4, 1, 200_000)).tobytes()
    assert found.tobytes() != noisy(points, 0.01, (0, 4, 2, 200_000)).tobytes()
    assert 0.1 < np.mean(noisy(points, 1e-6, (0,))["x"] != points["x"]) < 1


def test_the_interval_of_a_mean_is_that_of_its_standard_error() -> None:
    values = np.random.default_rng(3).normal(0, 1, 400)
    low, high = bootstrap(values, lambda some: some.mean(1))
    assert (high - low) / 2 == pytest.approx(1.96 * values.std() / 20, rel=0.05)


def test_leads_follow_from_the_seed() -> None:
    assert [lead_of(seed)[0] for seed in range(4)] == [*LEADS, LEADS[0]] and lead_of(1) == lead_of(1) != lead_of(4)
    for seed in (1, 2):
        kind, model = lead_of(seed)
        begins, ends = model["keys"]
        assert START_S < begins["time_s"] < ends["time_s"] and begins["speed_m_s"] == 8.0
        assert (ends["speed_m_s"] == 0.0) == (kind == "stops")
    assert JITTER.actors_s is not None and JITTER.actors_s < START_S


def test_a_log_has_every_other_frame() -> None:
    drive = street_of_seed(5).drive
    few = sparse(drive, EVERY)
    assert len(few.frames) == -(-len(drive.frames) // EVERY)
    assert few.time_s[3] == drive.time_s[3 * EVERY]
    (camera,) = few.cameras.values()
    assert camera.time_s[3] == drive.cameras[camera.sensor_id].time_s[3 * EVERY]
