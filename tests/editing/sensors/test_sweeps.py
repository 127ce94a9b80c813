"""Sweeps to look at, beside plain loops over their beams and boxes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from unisim_blender.core.data.sweep_cells import known_rays
from unisim_blender.core.evaluation.lidar_metrics import lidar_metrics
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import points_in_box
from unisim_blender.editing.sampled.source import DriveSource
from unisim_blender.editing.sensors.sweeps import (
    DROP_M,
    DROPS,
    RECORDED,
    SIMULATED,
    ViewedSweep,
    beam_ranges,
    range_differences,
    recorded_sweeps,
    same_beams,
    simulated_sweeps,
    stray_points,
    sweep_metrics,
)


def source_of(folder: Path) -> DriveSource:
    """A log's source, as an import opens it."""
    log = open_log(folder)
    return DriveSource(folder, None, log.drive, log, {})


def test_recorded_returns_and_drops_of_a_log(street_log: Path) -> None:
    source = source_of(street_log)
    assert source.log is not None
    returns, drops = recorded_sweeps(source, 1, drops=True)
    assert (returns.kind, drops.kind) == (RECORDED, DROPS[RECORDED])
    sweep, grid = source.log.sweep(returns.lidar, 1), source.log.sweep_grid(returns.lidar, 1)
    assert np.array_equal(returns.points, sweep.points) and np.array_equal(returns.attributes["ring"], sweep.ring)
    assert returns.attributes["depth"] == pytest.approx(np.linalg.norm(sweep.points - sweep.origins, axis=1))
    beams, dropped = grid.model.beams, {(ring, column) for ring, column in np.argwhere(~grid.returned & ~grid.blocked)}
    assert {(int(cell) % beams, int(cell) // beams) for cell in drops.attributes["cell"]} == dropped
    cell = drops.attributes["cell"].astype(int)
    assert np.linalg.norm(drops.points - grid.origins[cell % beams, cell // beams], axis=1) == pytest.approx(DROP_M)
    assert [one.kind for one in recorded_sweeps(source, 1)] == [RECORDED]
    assert [one.points.shape for one in recorded_sweeps(source, 99, drops=True)] == [(0, 3), (0, 3)]
    assert recorded_sweeps(replace(source, log=None), 1) == []


def test_recorded_points_are_of_the_actor_in_whose_box_they_lie(street_log: Path) -> None:
    source = source_of(street_log)
    assert source.log is not None
    (returns,) = recorded_sweeps(source, 2)
    sweep = source.log.sweep(returns.lidar, 2)
    labels = np.full(len(sweep.points), "", object)
    for at, (point, time_s) in enumerate(zip(sweep.points, sweep.time_s, strict=True)):
        for actor in sorted(source.drive.actors.values(), key=lambda actor: actor.uid):
            if not labels[at] and actor.start_s <= time_s <= actor.end_s:
                inside = points_in_box(point[None], actor.world_from_actor.at(float(time_s)), actor.size_m)[0]
                labels[at] = actor.label if inside else ""
    numbers = returns.attributes["class"].astype(int)
    assert [("", *returns.classes)[number] for number in numbers] == list(labels)
    assert len(set(labels)) > 1 and ((returns.attributes["instance"].astype(int) > 0) == (numbers > 0)).all()


def sweeps_of_five_beams() -> list[ViewedSweep]:
    """Beams 0 to 4: returned in both, at 10 and 9.5 m; in both, at 20 and 20.25 m; recorded alone; dropped in both;
    dropped in the recording alone. Beam 5 is blocked in the recording and returns in the simulation. Beam 0's second
    return has no cell."""

    def sweep(kind: str, cells: list[int], depths: list[float]) -> ViewedSweep:
        values = {
            "cell": np.array(cells), "depth": np.array(depths, np.float32), "intensity": np.ones(len(cells), np.float32)
        }  # fmt: skip
        return ViewedSweep("lidar", kind, np.zeros((len(cells), 3)), values)

    return [
        sweep(RECORDED, [0, 1, 2, -1], [10.0, 20.0, 30.0, 12.0]),
        sweep(DROPS[RECORDED], [3, 4], [0.0, 0.0]),
        sweep(SIMULATED, [4, 0, 1, 5], [40.0, 9.5, 20.25, 50.0]),
        sweep(DROPS[SIMULATED], [2, 3], [0.0, 0.0]),
    ]


def test_ranges_of_the_same_beams_are_compared() -> None:
    sweeps = sweeps_of_five_beams()
    ranges = beam_ranges(sweeps)
    nan = np.nan
    assert range_differences(sweeps[0], ranges) == pytest.approx([0.5, -0.25, nan, nan], nan_ok=True)
    assert range_differences(sweeps[2], ranges) == pytest.approx([nan, 0.5, -0.25, nan], nan_ok=True)
    metrics = sweep_metrics(ranges)
    assert metrics is not None
    assert metrics["depth_median_m"] == pytest.approx(0.375)
    assert metrics["drop_accuracy"] == pytest.approx(3 / 5)  # beams 0, 1 and 3 of those that are known
    assert sweep_metrics(beam_ranges([sweeps[0], sweeps[2]])) is None
    assert beam_ranges([sweeps[0], replace(sweeps[2], lidar="other")]) == {}


def test_stray_points_are_static_ones_where_the_recorded_beam_passed() -> None:
    recorded, simulated = (
        ViewedSweep("lidar", kind, np.zeros((4, 3)), {
            "cell": np.arange(4), "depth": np.array(depths), "intensity": np.ones(4), "class": np.array([0, 0, 0, 1])
        })
        for kind, depths in ((RECORDED, [10.0, 10.0, 10.0, 10.0]), (SIMULATED, [8.9, 9.1, 12.0, 3.0]))
    )  # fmt: skip
    assert stray_points([recorded, simulated], beam_ranges([recorded, simulated])) == 1
    assert stray_points([simulated], {}) == 0


def test_numbers_are_those_of_unisim_eval_for_the_same_rays(street_log: Path) -> None:
    source = source_of(street_log)
    assert source.log is not None
    returns, drops = recorded_sweeps(source, 1, drops=True)
    rays = known_rays(source.log, returns.lidar, 1)
    lidar, generator = source.drive.lidars[returns.lidar], np.random.default_rng(0)
    grid = source.log.sweep_grid(returns.lidar, 1)
    simulated, noise = grid.returned.copy(), generator.normal(0, 0.1, grid.depth_m.shape).astype(np.float32)
    simulated[generator.random(simulated.shape) < 0.1] = False
    ring, column = np.nonzero(simulated)
    depth, intensity = (grid.depth_m + noise)[simulated], grid.intensity[simulated] * np.float32(0.5)
    dropped = np.argwhere(~simulated)
    arrays = {
        "points": grid.origins[simulated] + grid.directions[simulated] * depth[:, None],
        "depth": depth,
        "intensity": intensity,
        "instance": np.zeros(len(depth), np.int32),
        "cell": (column * lidar.model.beams + ring).astype(np.int32),
        "dropped_cell": (dropped[:, 1] * lidar.model.beams + dropped[:, 0]).astype(np.int32),
        "dropped_origins": grid.origins[~simulated],
        "dropped_directions": grid.directions[~simulated],
    }
    shown = simulated_sweeps(returns.lidar, arrays, lidar.model.beams, [], same=True, frame=1)
    keep = ~grid.blocked
    expected = lidar_metrics(
        (grid.depth_m + noise)[keep], grid.intensity[keep] * 0.5, simulated[keep],
        rays.depth_m, rays.intensity, rays.returned,
    )  # fmt: skip
    assert sweep_metrics(beam_ranges([returns, drops, *shown])) == pytest.approx(expected, rel=1e-6)
    elsewhere = simulated_sweeps(returns.lidar, arrays, lidar.model.beams, [], same=False, frame=1)
    assert beam_ranges([returns, drops, *elsewhere]) == {}


def test_beams_are_the_recorded_ones_where_table_and_place_are(street_log: Path) -> None:
    drive = open_log(street_log).drive
    (lidar,) = drive.lidars.values()
    time_s = lidar.time_s[1]
    assert same_beams(lidar, time_s, drive, 1.0)
    assert not same_beams(lidar, time_s, drive, 2.0) and not same_beams(lidar, time_s + 0.01, drive, 1.0)
    lifted = np.eye(4)
    lifted[2, 3] = 0.5
    assert not same_beams(replace(lidar, world_from_lidar=lidar.world_from_lidar.transformed(lifted)), time_s, drive, 1)
    fewer = replace(lidar.model, columns=lidar.model.columns // 2)
    assert not same_beams(replace(lidar, model=fewer), time_s, drive, 1)
    assert not same_beams(replace(lidar, sensor_id="new"), time_s, drive, 1)
