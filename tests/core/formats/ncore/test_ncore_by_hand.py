"""NCore sequences of others: what NCore's API wrote from exact motion is read as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ncore_by_hand import (
    BOX_SIZE,
    CAMERA_FROM,
    COLUMNS,
    HEIGHT,
    LIDAR_FROM,
    ORIGIN,
    ROWS,
    START_US,
    SWEEP_US,
    SWEEPS,
    camera,
    car_pose,
    depth_of,
    exposure_us,
    fired_us,
    ray_of,
    rig_pose,
    write_by_hand,
)

from unisim_blender.core.data.log import Log
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.sensors.camera import camera_rays
from unisim_blender.core.world.own_rates import captures_of

ZERO_US = START_US + SWEEP_US - 1
"""The end of the first sweep: the drive's 0 s."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return open_log(write_by_hand(tmp_path_factory.mktemp("hand")))


def true_time(seconds: float) -> float:
    """The time by the clock of the exact motion."""
    return seconds + (ZERO_US - START_US) / 1e6


def test_frames_are_the_sweeps(log: Log) -> None:
    assert log.drive.name == "clip" and log.drive.frames == tuple(range(SWEEPS))
    assert log.missing == ("camera front: no image of 1 of 5 frames",)  # the last is 68 ms before its sweep's end
    np.testing.assert_allclose([log.drive.time_s[frame] for frame in log.drive.frames], 0.1 * np.arange(SWEEPS))
    np.testing.assert_allclose(
        log.drive.world_origin, ORIGIN + rig_pose(true_time(0.0))[:3, 3], atol=2e-4
    )  # the chord of 10 ms


def test_the_vehicle_and_its_sensors_are_where_they_were(log: Log) -> None:
    """The rig's poses are 10 ms apart: between them it is off its circle by no more than 0.02 mm."""
    drive = log.drive
    shift = drive.world_origin - ORIGIN
    for time in np.linspace(-0.09, 0.39, 97):
        for mount, track in (
            (np.eye(4), drive.world_from_ego),
            (CAMERA_FROM, drive.cameras["front"].world_from_camera),
            (LIDAR_FROM, drive.lidars["roof"].world_from_lidar),
        ):
            found, wanted = track.at(time), rig_pose(true_time(time)) @ mount
            np.testing.assert_allclose(found[:3, 3] + shift, wanted[:3, 3], atol=1.5e-4)
            np.testing.assert_allclose(found[:3, :3], wanted[:3, :3], atol=1e-6)


def test_images_have_times_of_their_own(log: Log) -> None:
    """All of them are captures, those that are nearest to a sweep's end are its frame's; rows have NCore's times,
    though no two images take equally long."""
    front = log.drive.cameras["front"]
    assert len(front.time_s) == 2 * SWEEPS - 1 and set(range(SWEEPS - 1)) < set(log.image_frames("front"))
    belong = [captures_of(front.time_s, log.drive, [frame], log.image_frames("front")) for frame in range(SWEEPS)]
    assert sorted(number for some in belong for number in some) == sorted(front.time_s)
    starts = sorted(START_US + number * SWEEP_US // 2 + 20_000 for number in range(2 * SWEEPS - 1))
    in_order = sorted(front.time_s, key=front.time_s.__getitem__)
    for number, (start, frame) in enumerate(zip(starts, in_order, strict=True)):
        rows = np.arange(HEIGHT) + 0.5
        times = camera_rays(front, front.time_s[frame], np.full(HEIGHT, 3.5), rows).time_s
        wanted = (start - ZERO_US + exposure_us(number) * np.arange(HEIGHT) / (HEIGHT - 1)) / 1e6
        np.testing.assert_allclose(times, wanted, atol=1e-9)
        assert log.image("front", frame)[0, 0].tolist() == [90, 90, 90]


def test_pixels_look_where_ncores_do(log: Log) -> None:
    sensors, torch = pytest.importorskip("ncore.sensors"), pytest.importorskip("torch")
    theirs = sensors.CameraModel.from_parameters(camera(), device="cpu", dtype=torch.float64)
    u, v = np.random.default_rng(0).uniform((0, 0), (40, 24), (200, 2)).T
    rays = theirs.image_points_to_camera_rays(torch.from_numpy(np.stack([u, v], -1))).numpy()
    np.testing.assert_allclose(log.drive.cameras["front"].model.unproject(u, v), rays, atol=1e-6)


@pytest.mark.parametrize("elements", [True, False])
def test_rays_are_where_they_were(elements: bool, tmp_path: Path) -> None:
    log = open_log(write_by_hand(tmp_path, elements=elements))
    shift = log.drive.world_origin - ORIGIN
    for frame in (0, 3):
        sweep = log.sweep("roof", frame)
        cells = {
            (int(ring), int(column)): i for i, (ring, column) in enumerate(zip(sweep.ring, sweep.column, strict=True))
        }
        assert sweep.drops is not None
        drops = set(zip(sweep.drops.ring.tolist(), sweep.drops.column.tolist(), strict=True))
        for row in range(len(ROWS)):
            for column in range(COLUMNS):
                if not np.isfinite(depth_of(row, column)):
                    assert (row, column) in drops
                    continue
                i = cells[row, column]
                seconds = (fired_us(frame, column) - START_US) / 1e6
                pose = rig_pose(seconds) @ LIDAR_FROM
                point = pose[:3, :3] @ ray_of(row, column) * depth_of(row, column) + pose[:3, 3]
                np.testing.assert_allclose(sweep.points[i] + shift, point, atol=2e-4)
                np.testing.assert_allclose(sweep.origins[i] + shift, pose[:3, 3], atol=1.5e-4)
                assert abs(sweep.time_s[i] + (ZERO_US - START_US) / 1e6 - seconds) < 1e-9
        assert len(drops) + len(cells) == COLUMNS * len(ROWS) and sweep.rank is None


def test_the_grid_has_the_sequences_drops(log: Log) -> None:
    grid = log.sweep_grid("roof", 2)
    assert grid.returned.sum() == 0.9 * grid.returned.size and not grid.blocked.any()
    np.testing.assert_array_equal(~grid.returned, np.arange(COLUMNS)[None] % 10 == [[3]] * len(ROWS))


def test_drops_are_inferred_where_a_sequence_gives_none(tmp_path: Path) -> None:
    log = open_log(write_by_hand(tmp_path, drops=False))
    assert log.sweep("roof", 2).drops is None
    grid = log.sweep_grid("roof", 2)
    lost = np.broadcast_to(np.arange(COLUMNS) % 10 == 3, grid.returned.shape)
    np.testing.assert_array_equal(~grid.returned, lost)
    assert not grid.blocked[:2].any()


def test_columns_that_are_never_fired_are_no_drops(tmp_path: Path) -> None:
    """Converters' tables have several columns for each of the sensor's; a cell without a ray says nothing there."""
    log = open_log(write_by_hand(tmp_path, drops=False, spare=4))
    grid = log.sweep_grid("roof", 2)
    assert grid.returned.shape == (len(ROWS), 4 * COLUMNS)
    np.testing.assert_array_equal(grid.blocked, ~grid.returned)


def test_boxes_are_where_they_were(log: Log) -> None:
    (car,) = log.drive.actors.values()
    shift = log.drive.world_origin - ORIGIN
    assert (car.uid, car.label, car.is_moving) == ("car", "Automobile", True)
    assert log.classes == {"Automobile": "rigid"}  # type: ignore[attr-defined]
    np.testing.assert_allclose(car.size_m, BOX_SIZE)
    keys = car.world_from_actor.times_s
    assert len(keys) == SWEEPS and car.start_s == keys[0] - 0.05 and car.end_s == keys[-1] + 0.05
    for key in keys:
        found, wanted = car.world_from_actor.at(key), car_pose(true_time(key))
        np.testing.assert_allclose(found[:3, 3] + shift, wanted[:3, 3], atol=1e-6)
        np.testing.assert_allclose(found[:3, :3], wanted[:3, :3], atol=1e-9)


@pytest.mark.parametrize("store", ["itar", "directory"])
def test_stores_of_every_kind_are_the_same_log(store: str, log: Log, tmp_path: Path) -> None:
    path = write_by_hand(tmp_path, store=store, groups=True)  # type: ignore[arg-type]
    assert len(list(tmp_path.glob("*.ncore4*"))) == 3
    for way in (path, tmp_path, *tmp_path.glob("*.ncore4*")):
        found = open_log(way)
        assert found.drive.frames == log.drive.frames and list(found.drive.cameras) == ["front"]
        np.testing.assert_array_equal(found.sweep("roof", 1).points, log.sweep("roof", 1).points)
        np.testing.assert_array_equal(found.image("front", 1), log.image("front", 1))
