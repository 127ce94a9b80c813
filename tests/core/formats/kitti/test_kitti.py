"""The reader of KITTI on the procedural street in KITTI's layouts: rays, poses, boxes and images come back to what they state."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import kitti_street as kitti
import numpy as np
import pytest
from click.testing import CliRunner
from kitti_street import FRAMES, KittiStreet
from opened_files import opened_below

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.data.log import extras_of
from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.kitti.beams import USUAL, decide
from unisim_blender.core.formats.kitti.read import LIDAR, KittiLog
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.world import light

MILLIMETRE = 1.2e-3
"""What the layout keeps of a point, calibration's seven digits included, as far as 80 m."""


@pytest.fixture(scope="module", params=[1, -1], ids=["counter-clockwise", "clockwise"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> KittiStreet:
    made = kitti.record(tmp_path_factory.mktemp("kitti") / "2011_09_26/2011_09_26_drive_0001_sync", request.param)
    kitti.write_raw(made)
    return made


@pytest.fixture(scope="module")
def log(made: KittiStreet) -> KittiLog:
    log = open_log(made.path)
    assert isinstance(log, KittiLog)
    return log


def start(made: KittiStreet) -> np.ndarray:  # type: ignore[type-arg]
    """Where the reader's world begins in the street's drive: the IMU's first record."""
    return np.asarray(made.ego(np.zeros(1))[1][0])


def test_times_begin_with_the_first_trigger(log: KittiLog) -> None:
    assert log.drive.frames == tuple(range(FRAMES))
    np.testing.assert_allclose(list(log.drive.time_s.values()), kitti.PERIOD_S * np.arange(FRAMES), atol=1e-9)


def test_poses_come_back_from_latitude_and_longitude(made: KittiStreet, log: KittiLog) -> None:
    times = np.linspace(-0.02, 0.48, 30)
    turned, place = made.ego(times + kitti.TRIGGER_S)
    poses = log.drive.world_from_ego.at(times)
    np.testing.assert_allclose(poses[:, :3, 3], place - start(made), atol=1e-5)
    np.testing.assert_allclose(poses[:, :3, :3], turned.as_matrix(), atol=1e-7)


def test_the_sun_stands_in_the_south_at_noon_by_the_dataset_s_summer_time(
    made: KittiStreet, log: KittiLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 13.02 o'clock, a quarter of an hour before. Of a drive of another year nobody knows the clock."""
    assert log.sun is None  # five frames are too short a way
    monkeypatch.setattr(light, "LEAST_TRAVEL_M", 1.0)
    sun = log.sun
    assert sun is not None and -91 < sun.azimuth_deg < -82 and 39 < sun.elevation_deg < 40.5
    later = shutil.copytree(made.path.parent, tmp_path / "day") / made.path.name
    for stamps in later.rglob("timestamps*.txt"):
        stamps.write_text(stamps.read_text().replace("2011-", "2012-"))
    assert extras_of(open_log(later)).sun is None


def test_the_spin_is_fitted_and_said(made: KittiStreet, log: KittiLog) -> None:
    assert log.drive.lidars[LIDAR].model.direction == made.direction
    word = {1: "turns counter-clockwise", -1: "turns clockwise"}[made.direction]
    assert any(word in sentence and "fitted spin" in sentence for sentence in log.missing)


def test_beams_are_the_lasers_heights_included(log: KittiLog) -> None:
    model = log.drive.lidars[LIDAR].model
    np.testing.assert_allclose(np.degrees(model.elevation_rad), kitti.ELEVATION_DEG, atol=0.005)
    assert model.columns == kitti.COLUMNS
    assert log._beams is not None
    np.testing.assert_allclose(log._beams.height_m, kitti.HEIGHT_M, atol=2e-3)


@pytest.mark.parametrize("frame", [0, 3])
def test_rays_come_back(made: KittiStreet, log: KittiLog, frame: int) -> None:
    sweep = log.sweep(LIDAR, frame)
    assert len(sweep.points) == len(made.points[frame])
    np.testing.assert_allclose(sweep.points + start(made), made.points[frame], atol=MILLIMETRE)
    np.testing.assert_allclose(sweep.origins + start(made), made.origins[frame], atol=2e-3)
    np.testing.assert_allclose(sweep.time_s + kitti.TRIGGER_S, made.time_s[frame], atol=6e-6)
    np.testing.assert_array_equal(sweep.ring, made.ring[frame])
    assert sweep.intensity.max() > 0.9 and sweep.intensity.min() >= 0


def test_cells_without_a_return_are_drops_from_their_own_lasers(made: KittiStreet, log: KittiLog) -> None:
    grid, truth = log.sweep_grid(LIDAR, 2), made.returned[2]
    assert grid.returned.sum() == truth.sum()
    dropped = ~grid.returned & ~grid.blocked
    empty = truth.size - truth.sum()
    assert empty > 200 and empty * 0.97 < dropped.sum() <= empty
    lidar = log.drive.lidars[LIDAR]
    rays = lidar_rays(lidar, lidar.time_s[2])
    up = lidar.world_from_lidar.at(grid.time_s[dropped])[:, :3, 2]
    heights = kitti.HEIGHT_M[np.nonzero(dropped)[0], None] * up
    np.testing.assert_allclose(grid.origins[dropped], rays.origins[dropped] + heights, atol=3e-3)


def test_boxes_are_where_the_beams_passed_them(made: KittiStreet, log: KittiLog) -> None:
    actors = {actor.uid.rsplit("-", 1)[1]: actor for actor in log.drive.actors.values()}
    order = kitti.write_tracklets(made, made.path / "tracklet_labels.xml")
    assert len(order) == len(actors) > 8
    moving = 0
    for number, uid in enumerate(order):
        actor, truth = actors[f"{number:04d}"], made.street.drive.actors[uid]
        assert actor.label == kitti.LABELS[truth.label]
        np.testing.assert_allclose(actor.size_m, truth.size_m, atol=1e-6)
        for (one, _), time in made.boxes.items():
            if one == uid:
                pose = truth.world_from_actor.at(time)
                found = actor.world_from_actor.at(time - kitti.TRIGGER_S)
                np.testing.assert_allclose(found[:3, 3] + start(made), pose[:3, 3], atol=2e-3)
                np.testing.assert_allclose(found[:3, :3], pose[:3, :3], atol=2e-2)
        moving += actor.is_moving
    assert moving >= 2


def test_cameras_look_through_the_rectified_projection(made: KittiStreet, log: KittiLog) -> None:
    """A point of the LiDAR's frame falls where P_rect R_rect Tr puts it, which counts from the first pixel's centre."""
    camera = log.drive.cameras["image_03"]
    assert set(log.drive.cameras) == {"image_02", "image_03"} and camera.model.shutter.duration_s == 0
    point = np.array([12.0, 1.5, -0.7])
    h = kitti.projection(3) @ np.append(kitti.rectified() @ kitti.CAMERA_AXES @ (point - kitti.CAMERA_PLACE), 1)
    world = log.drive.lidars[LIDAR].world_from_lidar.at(camera.time_s[4]) @ np.append(point, 1)
    local = np.linalg.solve(camera.world_from_camera.at(camera.time_s[4]), world)[:3]
    u, v, valid = camera.model.project(local)
    assert valid and (float(u), float(v)) == pytest.approx((h[0] / h[2] + 0.5, h[1] / h[2] + 0.5), abs=1e-3)
    image = log.image("image_03", 4)
    assert image.shape == (kitti.HEIGHT, kitti.WIDTH, 3) and (image[..., 2] == 160).all()
    assert log.image_frames("image_02") == tuple(range(FRAMES))


def test_tracking_labels_say_the_same(made: KittiStreet, log: KittiLog, tmp_path: Path) -> None:
    path = kitti.write_tracking(made, tmp_path / "training")
    tracking = open_log(path)
    assert tracking.drive.frames == tuple(range(FRAMES)) and tracking.drive.name == "tracking-0003"
    np.testing.assert_allclose(
        tracking.drive.world_from_ego.poses[:, :3, 3],
        log.drive.world_from_ego.at(tracking.drive.world_from_ego.times_s)[:, :3, 3]
        - log.drive.world_from_ego.at(0.0)[:3, 3],
        atol=1e-4,
    )
    assert len(tracking.drive.actors) == len(log.drive.actors)
    first = log.drive.world_from_ego.at(0.0)[:3, 3]
    places = np.array([actor.world_from_actor.at(0.2)[:3, 3] - first for actor in log.drive.actors.values()])
    heads = np.array([actor.world_from_actor.at(0.2)[:3, 0] for actor in log.drive.actors.values()])
    for actor in tracking.drive.actors.values():
        pose = actor.world_from_actor.at(0.2)
        nearest = np.linalg.norm(places - pose[:3, 3], axis=1).argmin()
        np.testing.assert_allclose(pose[:3, 3], places[nearest], atol=2e-3)
        np.testing.assert_allclose(pose[:3, 0], heads[nearest], atol=2e-2)
    sweep, same = tracking.sweep(LIDAR, 1), log.sweep(LIDAR, 1)
    np.testing.assert_allclose(sweep.points, same.points - first, atol=6e-3)  # poses are of other moments
    assert any("0.1 s from one frame to the next" in sentence for sentence in tracking.missing)
    assert open_log(tmp_path / "training/velodyne/0003").drive.frames == tracking.drive.frames


@pytest.fixture(scope="module")
def without_poses(made: KittiStreet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    day = tmp_path_factory.mktemp("without") / "2011_09_26"
    shutil.copytree(made.path.parent, day)
    shutil.rmtree(day / made.path.name / "oxts")
    return day / made.path.name


def test_poses_are_found_by_registration_and_their_error_is_said(made: KittiStreet, without_poses: Path) -> None:
    pytest.importorskip("small_gicp", reason="the extra registration is not installed")
    log = open_log(without_poses)
    times = np.array(list(log.drive.time_s.values()))
    turned, place = made.lidar(times + kitti.TRIGGER_S)
    poses = log.drive.lidars[LIDAR].world_from_lidar.at(times)
    truth = turned[0].inv().apply(place - place[0])
    found = (poses[:, :3, 3] - poses[0, :3, 3]) @ poses[0, :3, :3]
    assert np.linalg.norm(truth[-1]) > 3.5
    np.testing.assert_allclose(found, truth, atol=0.03)
    turn = np.array([(turned[0].inv() * one).as_matrix() for one in turned])
    np.testing.assert_allclose(poses[0, :3, :3].T @ poses[:, :3, :3], turn, atol=2e-3)
    assert log.drive.lidars[LIDAR].model.direction == made.direction
    (sentence,) = (one for one in log.missing if "registration" in one)
    assert "there are no poses" in sentence and " cm and " in sentence and "median" in sentence
    with opened_below(without_poses) as opened:
        again = open_log(without_poses)  # from the cache
    assert "velodyne_points/timestamps.txt" in opened and not any(name.endswith(".bin") for name in opened)
    np.testing.assert_array_equal(again.drive.world_from_ego.positions, log.drive.world_from_ego.positions)
    assert again.missing == log.missing
    unknown = ["--out", str(without_poses / "scene"), "--cameras", "none", "--iterations", "1"]
    told = CliRunner().invoke(unisim, ["train", str(without_poses), *unknown])
    assert told.exit_code and sentence in told.output, "train says so, too, before anything else"


def test_without_the_library_one_sentence_says_what_to_install(
    without_poses: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    with pytest.raises(LogError, match=r"drive_0001_sync: has no poses, .* needs small_gicp, .*\.\[registration\]"):
        open_log(without_poses)


def test_a_log_without_boxes_is_fine_and_training_says_what_it_cannot_do(
    without_poses: Path, made: KittiStreet, tmp_path: Path
) -> None:
    day = tmp_path / "2011_09_26"
    shutil.copytree(made.path.parent, day)
    path = day / made.path.name
    (path / "tracklet_labels.xml").unlink()
    log = open_log(path)
    assert not log.drive.actors and any("no boxes" in sentence for sentence in log.missing)
    options = ["--out", str(tmp_path / "scene"), "--preset", "tiny", "--cameras", "image_02", "--iterations", "2"]
    told = CliRunner().invoke(unisim, ["train", str(path), *options, "--quiet"], catch_exceptions=False)
    assert told.exit_code == 0 and "no boxes" in told.output and "no actor can be moved" in told.output
    info = CliRunner().invoke(unisim, ["info", str(path)])
    assert info.exit_code == 0 and "0 actors" in info.output and "velodyne: 32 beams x 900 columns" in info.output


def test_a_spin_that_is_not_sure_is_not_told() -> None:
    slow = decide(np.array([-2.0, -0.6, 0.7, -3.0, 4.0, -1.8]))
    assert slow.direction == USUAL and not slow.is_measured and "do not tell which way" in slow.sentence
    assert decide(np.array([-1.02, -0.98, -1.0])).direction == -1
    halves = decide(np.array([1.0, 1.0, 1.01, 0.99, 1.0, -1.0, -0.9, -1.0]))
    assert not halves.is_measured and "contradict" in halves.sentence
    assert not decide(np.zeros(0)).is_measured
