"""The reader of nuScenes on the procedural street in its layout: rays, drops, poses, boxes and images come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import nuscenes_street as nuscenes
import pytest
from click.testing import CliRunner
from nuscenes_street import CAMERAS, CYCLE_S, SWEEPS, NuscenesStreet, seconds, to_map

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.data.log import Sweep
from unisim_blender.core.data.own_vehicle import given_outline
from unisim_blender.core.formats.nuscenes.read import NuscenesLog
from unisim_blender.core.formats.nuscenes.scene import LIDAR
from unisim_blender.core.formats.readers import open_log

FRAME = 4


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> NuscenesStreet:
    return nuscenes.write(tmp_path_factory.mktemp("nuscenes"))


@pytest.fixture(scope="module")
def log(made: NuscenesStreet) -> NuscenesLog:
    log = open_log(made.root)
    assert isinstance(log, NuscenesLog)
    return log


@pytest.fixture(scope="module")
def sweep(log: NuscenesLog) -> Sweep:
    return log.sweep(LIDAR, FRAME)


def test_frames_are_the_sweeps_key_frames_and_those_between(made: NuscenesStreet, log: NuscenesLog) -> None:
    assert log.drive.frames == tuple(range(SWEEPS)) == log.sweep_frames(LIDAR)
    stamps = [(stamp - made.stamps_us[0]) * 1e-6 for stamp in made.stamps_us]
    np.testing.assert_allclose(list(log.drive.time_s.values()), stamps, atol=1e-9)
    assert log.drive.name == "scene-0001" and not log.missing


def test_poses_are_the_vehicles_in_the_map(made: NuscenesStreet, log: NuscenesLog) -> None:
    times = np.array([seconds(stamp) for stamp in made.stamps_us])
    turned, place = made.ego(times)
    poses = log.drive.world_from_ego.at(np.array(list(log.drive.time_s.values())))
    np.testing.assert_allclose(poses[:, :3, 3] + log.drive.world_origin, to_map(place), atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, :3], (nuscenes.MAP[0] * turned).as_matrix(), atol=1e-9)


def test_returns_have_their_own_origins(made: NuscenesStreet, log: NuscenesLog, sweep: Sweep) -> None:
    """Float32 keeps 4 micrometres at 70 m; a column without a drop has its origin from those beside it."""
    distance, roof = made.distance[FRAME], made.roof[FRAME]
    ring, column = np.nonzero((np.isfinite(distance) & ~roof)[::-1])
    np.testing.assert_array_equal(sweep.ring, ring)
    np.testing.assert_array_equal(sweep.column, column)
    origins = made.origins[FRAME][::-1][ring, column]
    points = origins + made.directions[FRAME][::-1][ring, column] * distance[::-1][ring, column, None]
    np.testing.assert_allclose(sweep.points + log.drive.world_origin, to_map(points), atol=2e-5)
    np.testing.assert_allclose(sweep.origins + log.drive.world_origin, to_map(origins), atol=5e-4)
    times = made.time_s[FRAME][column] - seconds(made.stamps_us[0])
    np.testing.assert_allclose(sweep.time_s, times, atol=1.5e-4)
    assert np.array_equal(np.round(sweep.intensity * 255).astype(int), column % 200)


def test_firings_without_a_return_are_drops(made: NuscenesStreet, log: NuscenesLog, sweep: Sweep) -> None:
    lost = (~np.isfinite(made.distance[FRAME]) & ~made.roof[FRAME])[::-1]
    ring, column = np.nonzero(lost)
    drops = sweep.drops
    assert drops is not None and len(ring) > 100
    np.testing.assert_array_equal(drops.ring, ring)
    np.testing.assert_array_equal(drops.column, column)
    origins = to_map(made.origins[FRAME][::-1][ring, column])
    np.testing.assert_allclose(drops.origins + log.drive.world_origin, origins, atol=2e-5)
    truth = nuscenes.MAP[0].apply(made.directions[FRAME][::-1][ring, column])
    assert np.degrees(np.arccos(np.clip((truth * drops.directions).sum(1), -1, 1))).max() < 0.05


def test_the_roof_is_left_out_and_its_cells_are_unknown(made: NuscenesStreet, log: NuscenesLog) -> None:
    grid = log.sweep_grid(LIDAR, FRAME)
    roof, lost = made.roof[FRAME][::-1], ~np.isfinite(made.distance[FRAME])[::-1]
    count = roof.shape[1]
    assert grid.blocked[:, :count][roof].all() and not grid.returned[:, :count][roof].any()
    np.testing.assert_array_equal(grid.returned[:, :count], ~roof & ~lost)
    np.testing.assert_array_equal(~(grid.returned | grid.blocked)[:, :count], lost & ~roof)
    assert grid.model.columns == 362 and grid.blocked[:, count:].all()


def test_beams_are_the_sensors(log: NuscenesLog) -> None:
    model = log.drive.lidars[LIDAR].model
    np.testing.assert_allclose(np.degrees(model.elevation_rad), nuscenes.ELEVATION_DEG[::-1], atol=0.01)
    offsets = nuscenes.OFFSET_DEG[::-1] - nuscenes.OFFSET_DEG.mean()
    found = np.degrees(model.azimuth_offset_rad)
    np.testing.assert_allclose(found - found.mean(), offsets, atol=0.05)
    assert model.direction == -1 and model.sweep_s == pytest.approx(361.5 * CYCLE_S, rel=3e-3)


def test_boxes_are_interpolated_between_key_frames(made: NuscenesStreet, log: NuscenesLog) -> None:
    moving = 0
    assert set(log.drive.actors) == set(made.instances.values()) and len(made.instances) > 8
    for uid, token in made.instances.items():
        truth, actor = made.street.drive.actors[uid], log.drive.actors[token]
        assert actor.label == nuscenes.LABELS[truth.label]
        np.testing.assert_allclose(actor.size_m, truth.size_m, atol=1e-9)
        keys = sorted(time for (one, _), time in made.passed.items() if one == uid)
        for time in (*keys, (keys[0] + keys[-1]) / 2):
            pose, found = truth.world_from_actor.at(time), actor.world_from_actor.at(time - seconds(made.stamps_us[0]))
            np.testing.assert_allclose(found[:3, 3] + log.drive.world_origin, to_map(pose[:3, 3]), atol=0.01)
            np.testing.assert_allclose(found[:3, :3], MAP_MATRIX @ pose[:3, :3], atol=5e-3)
        moving += actor.is_moving
    assert moving >= 2


MAP_MATRIX = nuscenes.MAP[0].as_matrix()


def test_images_have_a_rate_of_their_own(made: NuscenesStreet, log: NuscenesLog) -> None:
    for name in CAMERAS:
        camera = log.drive.cameras[name]
        numbers = sorted(camera.time_s, key=lambda number: camera.time_s[number])
        assert len(numbers) == nuscenes.IMAGES and set(numbers) == set(log.image_frames(name))
        stamps = nuscenes.FIRST_S - 0.012 + nuscenes.IMAGE_S * np.arange(nuscenes.IMAGES)
        found = np.array([camera.time_s[number] for number in numbers])
        np.testing.assert_allclose(found, stamps - seconds(made.stamps_us[0]), atol=2e-6)
        for order, number in enumerate(numbers):
            image = log.image(name, number)
            assert image.shape == (nuscenes.HEIGHT, nuscenes.WIDTH, 3)
            assert abs(float(image[..., 2].mean()) - 40 * order) < 3
        assert camera.model.shutter.duration_s == 0 and camera.model.cx == 49.5


def test_a_camera_looks_where_it_is_mounted(made: NuscenesStreet, log: NuscenesLog) -> None:
    """A point 10 m ahead of the vehicle, a metre to the left and two up, is left of the middle and above it."""
    camera = log.drive.cameras["CAM_FRONT"]
    time = camera.time_s[log.image_frames("CAM_FRONT")[1]]
    world = log.drive.world_from_ego.at(time) @ np.array([11.7, 1.02, 2.5, 1.0])
    local = np.linalg.solve(camera.world_from_camera.at(time), world)[:3]
    np.testing.assert_allclose(local, [-1.0, -1.0, 10.0], atol=1e-6)
    u, v, _ = camera.model.project(local)
    assert (float(u), float(v)) == pytest.approx((49.5 - 7.6, 30.0 - 7.65), abs=1e-4)


def test_the_vehicles_body_is_masked_in_the_back_camera_alone(log: NuscenesLog) -> None:
    model = log.drive.cameras["CAM_BACK"].model
    outline = given_outline(log, "CAM_BACK", model)
    assert outline is not None and (outline == model.height - 5).all()
    assert given_outline(log, "CAM_FRONT", log.drive.cameras["CAM_FRONT"].model) is None


def test_info_and_the_paths_that_stand_for_a_scene(made: NuscenesStreet, log: NuscenesLog) -> None:
    info = CliRunner().invoke(unisim, ["info", str(made.root)])
    assert info.exit_code == 0 and "lidar LIDAR_TOP: 32 beams x 362 columns, 7 sweeps" in info.output, info.output
    assert "vehicle.car" in info.output
    for path in (made.root / "v1.0-mini", made.root / nuscenes.sweep_file(0), made.root / nuscenes.sweep_file(1)):
        assert open_log(path).drive.name == log.drive.name


def test_a_table_of_a_gigabyte_is_read_in_pieces(made: NuscenesStreet, monkeypatch: pytest.MonkeyPatch) -> None:
    from unisim_blender.core.formats.nuscenes import scene

    monkeypatch.setattr(scene, "WHOLE_BYTES", 100)
    monkeypatch.setattr(scene, "PIECE_BYTES", 1000)
    path: Path = made.root / "v1.0-mini/sample_data.json"
    wanted = {row.key("token").text() for row in scene.rows(path, "token")}
    some = set(sorted(wanted)[3:5])
    assert {row.key("token").text() for row in scene.rows(path, "token", some)} == some
    assert set(scene.by_token(path, wanted)) == wanted
    assert open_log(made.root).drive.frames == tuple(range(SWEEPS))
