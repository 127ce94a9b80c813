"""Beam tables with columns that are not even, several speeds and phases: rays against plain formulas, cells found again."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unisim_blender.core.data.log import Drops, Sweep
from unisim_blender.core.data.sweep_cells import find_cells, make_grid, rank_returns, sweep_rays
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.formats.common.sensor_file import LidarSetup, LogSetup, read_setup, write_setup
from unisim_blender.core.geometry import FloatArray, Trajectory, quaternion_from_yaw
from unisim_blender.core.json_file import Node
from unisim_blender.core.scenario.sensors.document import LidarSpec
from unisim_blender.core.scenario.sensors.select import lidar_model
from unisim_blender.core.sensors.beam_tables import read_beam_table
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import exposure_window
from unisim_blender.core.world.drive import Lidar, LidarModel, SpinPhase
from unisim_blender.core.world.drive_json import _lidar_to_json, _read_lidar
from unisim_blender.core.world.encoding import decode_sensor, encode_sensor
from unisim_blender.editing.sensors.mounts import lidar_json
from unisim_blender.editing.sensors.mounts import lidar_model as from_object

REAL = Path(os.environ.get("UNISIM_LIDAR_MODELS", Path(__file__).parents[4] / "shared/data/lidar_models"))


def solid_state() -> LidarModel:
    """Beams that sweep 120 degrees, denser ahead, later columns slower; each beam fires later than the one above."""
    azimuth = np.radians(60) * np.linspace(1, -1, 41) ** 3
    azimuth = azimuth + np.linspace(0.1, -0.1, 41)
    times = -0.05 * np.linspace(1, 0, 41) ** 2
    return LidarModel(
        np.radians([4.0, 1.0, -3.0]), np.radians([0.5, 0.0, -0.5]), 41, 0.05, direction=-1,
        column_azimuth_rad=azimuth, column_time_s=times, beam_time_s=np.array([0.0, 1e-5, 3e-5]),
    )  # fmt: skip


def track() -> Trajectory:
    keys = np.linspace(-1, 3, 41)
    return Trajectory(keys, np.stack([20 * keys, keys**2, 0 * keys + 2], -1), quaternion_from_yaw(0.4 * keys))


def on_its_way(model: LidarModel, phase: SpinPhase | None = None) -> Lidar:
    return Lidar("l", model, track(), {0: 0.5, 1: 0.62, 2: 0.7}, phase=phase)


def test_each_ray_has_its_own_direction_origin_and_time() -> None:
    model = solid_state()
    lidar = on_its_way(model, SpinPhase(np.array([0.5, 0.7]), np.array([0.0, 0.2])))
    rays = lidar_rays(lidar, 0.62)
    assert model.column_azimuth_rad is not None and model.column_time_s is not None and model.beam_time_s is not None
    for beam in range(3):
        for column in (0, 7, 40):
            time = 0.62 + model.column_time_s[column] + model.beam_time_s[beam]
            a = model.column_azimuth_rad[column] + model.azimuth_offset_rad[beam] + 0.12
            e = model.elevation_rad[beam]
            pose = track().at(time)
            expected = pose[:3, :3] @ np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
            assert rays.time_s[beam, column] == pytest.approx(time, abs=1e-12)
            np.testing.assert_allclose(rays.directions[beam, column], expected, atol=1e-9)
            np.testing.assert_allclose(rays.origins[beam, column], pose[:3, 3], atol=1e-9)
    first, last = exposure_window(lidar, 0.62)
    assert first <= rays.time_s.min() and rays.time_s.max() <= last and last - first < 0.051


@pytest.mark.parametrize("turned", (0.0, 0.3, -2.5, 40.0))
@pytest.mark.parametrize("clockwise", (True, False))
def test_cells_of_uneven_columns_are_found_again(turned: float, clockwise: bool) -> None:
    model = solid_state()
    assert model.column_azimuth_rad is not None
    if not clockwise:
        model = dataclasses.replace(model, direction=1, column_azimuth_rad=model.column_azimuth_rad[::-1])
    still = Trajectory(np.zeros(1), np.zeros((1, 3)), quaternion_from_yaw(np.zeros(1)))
    lidar = Lidar("l", model, still, {0: 0.0}, phase=SpinPhase(np.zeros(1), np.array([turned])))
    rays = lidar_rays(lidar, 0.0)
    ring, column = find_cells((rays.directions * 9.0).reshape(-1, 3), lidar.model_at(0.0))
    np.testing.assert_array_equal(ring.reshape(3, 41), np.indices((3, 41))[0])
    np.testing.assert_array_equal(column.reshape(3, 41), np.indices((3, 41))[1])
    back = -rays.directions[1:2, 20] * np.array([1.0, 1.0, -1.0]) * 9.0
    assert find_cells(back, lidar.model_at(0.0))[1].tolist() == [-1], "nothing is scanned behind"


def test_a_table_of_even_columns_is_the_table_without() -> None:
    even = LidarModel(np.radians([3.0, -3.0]), np.radians([1.0, -1.0]), 36)
    assert even.column_azimuth_rad is None
    azimuth = even.start_azimuth_rad + even.direction * 2 * np.pi * (np.arange(36) + 0.5) / 36
    times = even.sweep_s * ((np.arange(36) + 0.5) / 36 - 1)
    stated = dataclasses.replace(even, column_azimuth_rad=azimuth, column_time_s=times, beam_time_s=np.zeros(2))
    a, b = lidar_rays(on_its_way(even), 0.5), lidar_rays(on_its_way(stated), 0.5)
    for name in ("origins", "directions", "time_s"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-12)
    local = np.random.default_rng(0).normal(size=(4000, 3)) * [1, 1, 0.05]
    for x, y in zip(find_cells(local, even), find_cells(local, stated), strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"column_azimuth_rad": np.zeros(3)}, "must be 41 numbers"),
        ({"beam_time_s": np.array([0, np.nan, 0])}, "must be 3 numbers"),
        ({"direction": 1}, "must turn in the direction 1"),
        ({"column_azimuth_rad": -0.2 * np.arange(41)}, "by less than a turn"),
        ({"column_azimuth_rad": -1e308 * np.linspace(-1, 1, 41)}, "by less than a turn"),
        ({"columns": 2_800_000}, "3 beams x 2800000 columns are more than 8388608 cells"),
    ],
)
def test_a_wrong_table_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(solid_state(), **change)


# Messages and files


def equal(a: LidarModel, b: LidarModel) -> bool:
    return all(np.array_equal(value, getattr(b, name)) for name, value in vars(a).items())


def test_tables_survive_messages_and_files(tmp_path: Path) -> None:
    lidar = on_its_way(solid_state(), SpinPhase(np.array([0.5, 0.7]), np.array([0.1, 0.4])))
    sent = decode_sensor(encode_sensor(lidar, 0.3, 0.7))
    stored = _read_lidar("l", Node(json.loads(json.dumps(_lidar_to_json(lidar))), "x", UnisimError))
    setup = LogSetup("x", (0,), 0.0, np.zeros(3), {}, {"l": LidarSetup(0, np.eye(4), lidar.model, lidar.phase)})
    (tmp_path / "meta").mkdir()
    write_setup(tmp_path, setup)
    read = read_setup(tmp_path)
    assert isinstance(sent, Lidar) and read is not None
    for one in (sent, stored, read.lidars["l"]):
        assert equal(one.model, lidar.model) and one.phase is not None and one.phase.at(0.6) == pytest.approx(0.25)
    assert equal(from_object(lidar_json(lidar.model)), lidar.model)


def test_tables_that_are_not_there_are_not_written() -> None:
    """So that files and messages of before keep their bytes."""
    model = LidarModel(np.zeros(2), np.zeros(2))
    assert "column_azimuth_rad" not in lidar_json(model) and "phase" not in _lidar_to_json(on_its_way(model))


def test_a_scenario_changes_a_table_of_uneven_columns() -> None:
    old = solid_state()
    assert old.column_azimuth_rad is not None and old.column_time_s is not None
    new = lidar_model(old, LidarSpec("l", columns=81), "here")
    assert new.column_azimuth_rad is not None and new.column_time_s is not None
    np.testing.assert_allclose(
        new.column_azimuth_rad[1::2][:40], np.interp(np.arange(81)[1::2][:40], np.arange(81), new.column_azimuth_rad)
    )
    assert new.column_azimuth_rad[40] == pytest.approx(old.column_azimuth_rad[20]) and len(new.column_time_s) == 81
    assert lidar_model(old, LidarSpec("l", elevation_deg=(1.0, 0.0)), "here").beam_time_s is None
    assert lidar_model(old, LidarSpec("l", sweep_s=0.2), "here").column_time_s is None


# Drops and returns that the log gives


def swept() -> tuple[Lidar, Sweep]:
    """Columns 0 to 9 return twice, 10 to 19 once, 20 to 29 are drops, of the others the log says nothing."""
    lidar = on_its_way(solid_state())
    rays = lidar_rays(lidar, 0.5)
    ring, column = (
        np.append(x, y) for x, y in zip(np.nonzero(np.ones((3, 20))), np.nonzero(np.ones((3, 10))), strict=True)
    )
    depth = np.append(np.full(60, 20.0), np.full(30, 8.0))  # the nearer one is the weaker
    intensity = np.append(np.full(60, 0.6), np.full(30, 0.2)).astype(np.float32)
    rank = rank_returns(ring * 41 + column, intensity, depth)
    origins, directions = rays.origins[ring, column], rays.directions[ring, column]
    r, c = (x.ravel() for x in np.meshgrid(range(3), range(20, 30), indexing="ij"))
    turned: FloatArray = rays.directions[r, c] + [0, 0, 1e-3]
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    drops = Drops(rays.origins[r, c] + 0.01, turned, rays.time_s[r, c] + 1e-4, r.astype(np.int32), c.astype(np.int32))
    points = origins + depth[:, None] * directions
    cells = ring.astype(np.int32), column.astype(np.int32)
    return lidar, Sweep(points, origins, rays.time_s[ring, column], intensity, *cells, cells[0], rank, drops)


def test_training_takes_the_strongest_return_and_keeps_the_others() -> None:
    lidar, sweep = swept()
    grid = make_grid(sweep, lidar, 0, np.zeros((3, 41), bool))
    np.testing.assert_allclose(grid.depth_m[:, :20], 20.0, rtol=1e-6)
    assert grid.others is not None and len(grid.others.rank) == 30 and (grid.others.rank == 1).all()
    np.testing.assert_allclose(grid.others.depth_m, 8.0, rtol=1e-6)
    assert set(grid.others.column.tolist()) == set(range(10))


def test_drops_are_the_logs_own() -> None:
    lidar, sweep = swept()
    assert sweep.drops is not None
    blocked = np.zeros((3, 41), bool)
    blocked[0, 25] = True
    grid = make_grid(sweep, lidar, 0, blocked)
    assert grid.returned[:, :20].all() and not grid.returned[:, 20:].any()
    assert not grid.blocked[1:, :30].any() and grid.blocked[:, 30:].all() and grid.blocked[0, 25]
    np.testing.assert_array_equal(grid.directions[:, 20:30].reshape(-1, 3), sweep.drops.directions)
    np.testing.assert_array_equal(grid.origins[:, 20:30].reshape(-1, 3), sweep.drops.origins)
    np.testing.assert_array_equal(grid.time_s[:, 20:30].ravel(), sweep.drops.time_s)
    inferred = make_grid(dataclasses.replace(sweep, drops=None), lidar, 0, np.zeros((3, 41), bool))
    assert not inferred.blocked.any(), "without them every empty cell is a drop"


def test_rays_without_a_beam_table() -> None:
    _, sweep = swept()
    rays = sweep_rays(sweep)
    assert int(rays.returned.sum()) == 60 and len(rays.returned) == 90
    np.testing.assert_allclose(rays.depth_m[:60], 20.0, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rays.directions, axis=1), 1)


def test_ranks() -> None:
    ray = np.array([4, 2, 4, 4, 9])
    intensity = np.array([0.1, 0.5, 0.9, 0.9, 0.0], np.float32)
    assert rank_returns(ray, intensity, np.array([1.0, 1, 7, 5, 1])).tolist() == [2, 0, 1, 0, 0]
    assert rank_returns(ray[:0], intensity[:0], np.zeros(0)).tolist() == []


# Files of beam tables


def write_table(path: Path, **changes: Any) -> Path:
    document = {
        "spinning_frequency_hz": 20.0, "spinning_direction": "ccw", "n_rows": 2, "n_columns": 4,
        "row_elevations_rad": [-0.1, 0.2], "row_azimuth_offsets_rad": [0.01, 0.02],
        "column_azimuths_rad": [3.0, 3.0 + np.pi / 2 - 2 * np.pi, 3.0 + np.pi - 2 * np.pi, 3.0 + 3 * np.pi / 2 - 2 * np.pi],
    }  # fmt: skip
    path.write_text(json.dumps({**document, **changes}))
    return path


def test_a_table_is_read_highest_beam_first(tmp_path: Path) -> None:
    model = read_beam_table(write_table(tmp_path / "t.json", row_times_s=[1e-6, 2e-6]), max_range_m=77.0)
    assert model.elevation_rad.tolist() == [0.2, -0.1] and model.azimuth_offset_rad.tolist() == [0.02, 0.01]
    assert model.beam_time_s is not None and model.beam_time_s.tolist() == [2e-6, 1e-6]
    assert (model.columns, model.direction, model.sweep_s, model.max_range_m) == (4, 1, 0.05, 77.0)
    assert model.column_azimuth_rad is None and model.start_azimuth_rad == pytest.approx(3.0 - np.pi / 4)
    uneven = read_beam_table(write_table(tmp_path / "u.json", column_azimuths_rad=[0.0, 0.1, 0.3, 0.4]))
    assert uneven.column_azimuth_rad is not None and uneven.column_azimuth_rad.tolist() == [0.0, 0.1, 0.3, 0.4]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n_rows": 3}, "n_rows: is not 2"),
        ({"spinning_direction": "up"}, 'spinning_direction: must be "cw" or "ccw", not "up"'),
        ({"spinning_frequency_hz": 0}, "spinning_frequency_hz: must be above 0"),
        ({"row_azimuth_offsets_rad": [0.0]}, "row_azimuth_offsets_rad"),
        ({"column_azimuths_rad": []}, "column_azimuths_rad: is empty"),
        ({"spinning_direction": "cw"}, "column_azimuths_rad: cannot be used: .*direction -1"),
    ],
)
def test_a_bad_file_is_one_sentence(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(UnisimError, match=message) as caught:
        read_beam_table(write_table(tmp_path / "t.json", **change))
    assert "t.json" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no beam tables at {REAL}")
@pytest.mark.parametrize(
    ("name", "beams", "columns", "uneven"),
    [
        ("-pandaset", 64, 1800, False),
        ("-waymo", 64, 2650, False),
        ("-hesai-at128", 128, 1200, True),
        ("", 128, 3600, True),
    ],
)
def test_real_tables(name: str, beams: int, columns: int, uneven: bool) -> None:
    model = read_beam_table(REAL / f"row-offset-spinning-lidar-model-parameters{name}.json")
    assert (model.beams, model.columns, model.column_azimuth_rad is not None) == (beams, columns, uneven)
    still = Trajectory(np.zeros(1), np.zeros((1, 3)), quaternion_from_yaw(np.zeros(1)))
    directions = lidar_rays(Lidar("l", model, still, {0: 0.0}), 0.0).directions
    file = json.loads((REAL / f"row-offset-spinning-lidar-model-parameters{name}.json").read_text())
    azimuth = np.array(file["column_azimuths_rad"])[None] + np.array(file["row_azimuth_offsets_rad"])[:, None]
    found = np.arctan2(directions[..., 1], directions[..., 0])
    assert np.abs(np.angle(np.exp(1j * (found - azimuth)))).max() < 1e-5
    ring, column = find_cells((directions * 30).reshape(-1, 3), model)
    assert (np.unique(ring * columns + column, return_counts=True)[1] == 1).all()
