"""The reader of Waymo Open v2 on the procedural street, written in the dataset's layout by the test's own code."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
pytest.importorskip("scipy", reason="the extra torch is not installed")

from waymo_street import (  # noqa: E402
    CAMERAS,
    COLUMNS,
    GLOBAL,
    INCLINATIONS,
    ROWS,
    SEGMENT,
    TURNS_US,
    Lens,
    Turn,
    WaymoStreet,
)

from unisim_blender.core.formats.readers import open_log  # noqa: E402
from unisim_blender.core.formats.waymo.read import WaymoLog  # noqa: E402
from unisim_blender.core.geometry import FloatArray  # noqa: E402
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole  # noqa: E402
from unisim_blender.core.sensors.camera import camera_rays  # noqa: E402
from unisim_blender.core.sensors.lidar import lidar_rays  # noqa: E402

FLOAT32_M = 2e-4
"""What float32 takes from global coordinates of a thousand metres, and from angles times 75 m."""


@pytest.fixture(scope="module")
def made() -> WaymoStreet:
    return WaymoStreet()


@pytest.fixture(scope="module")
def path(made: WaymoStreet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("waymo") / "training"
    made.write(folder)
    return folder


@pytest.fixture(scope="module")
def log(path: Path) -> WaymoLog:
    read = open_log(path)
    assert isinstance(read, WaymoLog)
    return read


@pytest.fixture(scope="module")
def turn(made: WaymoStreet) -> Turn:
    return made.measure(1)


def moved(log: WaymoLog) -> FloatArray:
    """What to add to positions of the log to have the street's."""
    return np.asarray(log.drive.world_origin - GLOBAL)


def test_a_segment_is_its_folder_or_any_of_its_files(path: Path) -> None:
    for file in (path / "lidar" / f"{SEGMENT}.parquet", path / "vehicle_pose" / f"{SEGMENT}.parquet"):
        assert open_log(file).drive.name == SEGMENT


def test_poses_are_the_vehicles(made: WaymoStreet, log: WaymoLog) -> None:
    assert log.drive.frames == (0, 1, 2, 3) and log.missing == ()
    for frame in log.drive.frames:
        assert log.drive.time_s[frame] == made.seconds(frame)
    times = np.linspace(0.03, 0.38, 50)
    turned, place = made.vehicle(times)
    poses = log.drive.world_from_ego.at(times)
    # between the times of images' poses the street's path bends
    np.testing.assert_allclose(poses[:, :3, 3] + moved(log), place, atol=1e-3)
    np.testing.assert_allclose(poses[:, :3, :3], turned.as_matrix(), atol=1e-4)
    np.testing.assert_allclose(log.drive.world_from_ego.at(0.0)[:3, 3], 0, atol=1e-9)


def test_rays_are_those_that_were_fired(made: WaymoStreet, log: WaymoLog, turn: Turn) -> None:
    sweep = log.sweep("top", 1)
    cells, first, second = made.second(1, turn)
    assert len(sweep.points) == np.isfinite(turn.distance).sum() + cells.sum()
    at = sweep.ring, sweep.column
    np.testing.assert_allclose(sweep.origins + moved(log), turn.origins[at], atol=FLOAT32_M)
    np.testing.assert_allclose(sweep.time_s, turn.time_s[at], atol=1e-9)
    assert sweep.rank is not None
    distance = np.linalg.norm(sweep.points - sweep.origins, axis=1)
    is_second = distance > turn.distance[at] + 1
    assert is_second.sum() == cells.sum()
    true = turn.origins[at] + (turn.distance[at] + 1.5 * is_second)[:, None] * turn.directions[at]
    np.testing.assert_allclose(sweep.points + moved(log), true, atol=FLOAT32_M)
    intensity = np.tanh(np.where(is_second, second[at], first[at]))
    np.testing.assert_allclose(sweep.intensity, intensity, atol=1e-6)
    stronger = (second > first) & cells
    np.testing.assert_array_equal(sweep.rank == 0, np.where(is_second, stronger[at], ~stronger[at]))


def test_cells_without_a_return_are_drops_with_their_rays(log: WaymoLog, turn: Turn) -> None:
    drops = log.sweep("top", 1).drops
    assert drops is not None and len(drops.ring) == (~np.isfinite(turn.distance)).sum() > 100
    at = drops.ring, drops.column
    assert not np.isfinite(turn.distance[at]).any()
    np.testing.assert_allclose(drops.origins + moved(log), turn.origins[at], atol=2e-3)
    np.testing.assert_allclose((drops.directions * turn.directions[at]).sum(-1), 1, atol=1e-7)
    np.testing.assert_allclose(drops.time_s, turn.time_s[at], atol=1e-9)
    grid = log.sweep_grid("top", 1)
    np.testing.assert_array_equal(grid.returned, np.isfinite(turn.distance))
    assert grid.blocked.mean() < 0.01 and grid.others is not None
    assert len(grid.others.ring) == (np.isfinite(turn.distance) & (np.arange(COLUMNS) % 7 == 0)).sum()


def test_the_beam_table_fires_the_same_rays(log: WaymoLog, turn: Turn) -> None:
    lidar = log.drive.lidars["top"]
    assert (lidar.model.beams, lidar.model.columns) == (ROWS, COLUMNS)
    np.testing.assert_allclose(lidar.model.elevation_rad, INCLINATIONS[::-1], atol=1e-12)
    rays = lidar_rays(lidar, lidar.time_s[1])
    np.testing.assert_allclose(rays.time_s, turn.time_s, atol=1e-4)  # turns differ by as much
    np.testing.assert_allclose(rays.origins + moved(log), turn.origins, atol=3e-3)
    assert (rays.directions * turn.directions).sum(-1).min() > np.cos(1e-3)


@pytest.mark.parametrize("camera", CAMERAS, ids=["front", "side_left"])
def test_pixels_look_where_columns_looked_when_they_were_exposed(
    made: WaymoStreet, log: WaymoLog, camera: Lens
) -> None:
    name = {1: "front", 4: "side_left"}[camera.number]
    read = log.drive.cameras[name]
    assert read.model.shutter.axis == "columns" and isinstance(read.model.lens, OpenCVPinhole)
    matrix = np.array([[camera.focal[0], 0, camera.centre[0]], [0, camera.focal[1], camera.centre[1]], [0, 0, 1]])
    first, last = made.shutter(camera, 2)
    # a point straight ahead, left and right of it, near the image's edges
    middle_turned, middle_place = made.vehicle([(first + last) / 2])
    seen = 0
    for aside, up in ((0.0, 0.0), (-0.3, 0.1), (0.3, -0.1), (0.15, 0.05), (-0.38, -0.1)):
        ahead = camera.turned.apply([20.0, 20 * aside, 20 * up]) + camera.place
        point = middle_place[0] + middle_turned[0].apply(ahead)
        u, v = camera.width / 2, 0.0
        for _ in range(20):
            turned, place = made.vehicle([first + (last - first) * u / camera.width])
            x, y, z = camera.turned.inv().apply(turned[0].inv().apply(point - place[0]) - camera.place)
            in_cv = np.array([[-y, -z, x]])
            pixels, _ = cv2.projectPoints(in_cv, np.zeros(3), np.zeros(3), matrix, np.array(camera.bends))
            u, v = pixels[0, 0]
        if not (0 < u < camera.width and 0 < v < camera.height):
            continue
        seen += 1
        rays = camera_rays(read, read.time_s[2], np.array([u]), np.array([v]))
        beside = point - moved(log) - rays.origins[0]
        off = np.linalg.norm(beside - (beside @ rays.directions[0]) * rays.directions[0])
        assert off < 2e-3, (aside, up)
        assert rays.time_s[0] == pytest.approx(first + (last - first) * u / camera.width, abs=2e-6)
    assert seen >= 4


def test_images_are_those_of_their_frames(log: WaymoLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    assert set(log.drive.cameras) == {"front", "side_left"}
    for name, camera in log.drive.cameras.items():
        assert log.image_frames(name) == (0, 1, 2, 3)
        for frame in log.image_frames(name):
            image = log.image(name, frame)
            assert image.shape == (camera.model.height, camera.model.width, 3)
            assert abs(int(image[5, 5, 0]) - 40 * frame) < 4
            assert abs(int(image[5, 5, 1]) - 30 * {"front": 1, "side_left": 4}[name]) < 4
            copy = log.image_path(name, frame)
            assert copy is not None and copy.is_relative_to(tmp_path) and copy == log.image_path(name, frame)
            assert copy.read_bytes() == log.encoded_image(name, frame)


def test_boxes_are_where_things_were_when_the_beams_passed(made: WaymoStreet, log: WaymoLog) -> None:
    assert set(log.drive.actors) == set(made.street.drive.actors)
    moving = 0
    for uid, true in made.street.drive.actors.items():
        read, track = log.drive.actors[uid], true.world_from_actor
        assert read.label == {"Cones": "TYPE_SIGN"}.get(true.label, "TYPE_VEHICLE")
        np.testing.assert_allclose(read.size_m, true.size_m, atol=1e-9)
        far = float(np.linalg.norm(track.positions_at(0.35) - track.positions_at(0.05)))
        if far > 2.5:  # a log of 0.4 s tells no slower motion from a box that wanders
            moving += 1
            assert read.is_moving
            keys = read.world_from_actor.times_s
            np.testing.assert_allclose(
                read.world_from_actor.positions + moved(log), track.positions_at(keys), atol=0.02
            )
        elif far == 0:
            assert not read.is_moving
            pose, own = track.at(0.1), read.world_from_actor.at(0.1)
            np.testing.assert_allclose(own[:3, 3] + moved(log), pose[:3, 3], atol=1e-3)
            np.testing.assert_allclose(own[:3, :3], pose[:3, :3], atol=0.01)
    assert moving >= 1


def test_turns_last_until_the_next_frame(log: WaymoLog) -> None:
    for frame in (0, 1, 2):
        sweep = log.sweep("top", frame)
        turn_s = TURNS_US[frame] / 1e6
        np.testing.assert_allclose(
            sweep.time_s, log.drive.time_s[frame] + turn_s * (sweep.column + 0.5) / COLUMNS, atol=1e-9
        )
