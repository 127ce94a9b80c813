"""The reader of KITTI on 20 real sweeps and images without poses; skipped where they are absent.

UNISIM_KITTI names a folder with the drive (image_02, velodyne_points), UNISIM_KITTI_CALIBRATION one with its day's calib_*.txt.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from unisim_blender.core.data.values import doubts
from unisim_blender.core.formats.kitti.read import LIDAR, KittiLog
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray

pytest.importorskip("small_gicp", reason="the extra registration is not installed")
DATA = Path(__file__).parents[5] / "shared/data/kitti"
DRIVE = Path(os.environ.get("UNISIM_KITTI", DATA / "raw_2011_09_26"))
DAY = DATA / "calibration_2011_09_26/2011_09_26_calib/2011_09_26"
CALIBRATION = Path(os.environ.get("UNISIM_KITTI_CALIBRATION", DAY))
pytestmark = pytest.mark.skipif(
    not (DRIVE.is_dir() and CALIBRATION.is_dir()), reason=f"no real drive at {DRIVE}; set UNISIM_KITTI to one"
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> KittiLog:
    day = tmp_path_factory.mktemp("kitti") / "2011_09_26"
    drive = day / "drive"
    drive.mkdir(parents=True)
    for file in CALIBRATION.glob("calib_*.txt"):
        (day / file.name).symlink_to(file)
    for folder in ("image_02", "velodyne_points"):
        (drive / folder).symlink_to(DRIVE / folder)
    log = open_log(drive)
    assert isinstance(log, KittiLog)
    return log


def test_beams_are_those_of_an_hdl_64e(log: KittiLog) -> None:
    """Its two blocks of lasers, one above the other, each from its own height."""
    model = log.drive.lidars[LIDAR].model
    assert model.beams == 64 and 1900 < model.columns < 2200
    elevation = np.degrees(model.elevation_rad)
    assert (np.diff(elevation) < 0).all() and 1.5 < elevation[0] < 2.5 and -25.5 < elevation[-1] < -24
    assert log._beams is not None
    heights = log._beams.height_m
    assert (np.diff(heights) < 1e-3).all() and heights[31] - heights[32] == pytest.approx(0.072, abs=0.005)


def test_points_lie_on_their_beams(log: KittiLog) -> None:
    """As seen from the beam's own origin; from the sensor's they are off by tenths of a degree and more."""
    sweep, lidar = log.sweep(LIDAR, 5), log.drive.lidars[LIDAR]
    poses = lidar.world_from_lidar.at(sweep.time_s)
    known = sweep.ring >= 0
    assert known.mean() > 0.999

    def off_deg(origins: FloatArray) -> FloatArray:
        ray = np.einsum("nji,nj->ni", poses[known, :3, :3], (sweep.points - origins)[known])
        elevation = np.arctan2(ray[:, 2], np.hypot(ray[:, 0], ray[:, 1]))
        return np.abs(np.degrees(elevation - lidar.model.elevation_rad[sweep.ring[known]]))

    assert np.percentile(off_deg(sweep.origins), 95) < 0.03
    assert np.median(off_deg(poses[:, :3, 3])) > 0.3


def test_poses_are_found_and_said(log: KittiLog) -> None:
    """A quarter of a metre a sweep at first, slowing down; no step differs much from the one before."""
    steps = np.diff(log.drive.world_from_ego.positions, axis=0)
    forward = np.linalg.norm(steps, axis=1)
    assert 0.23 < forward[:4].mean() < 0.26 and 0.19 < forward[-4:].mean() < 0.23
    assert np.abs(np.diff(forward)).max() < 0.025
    (sentence,) = (one for one in log.missing if "registration" in one)
    assert "20 sweeps" in sentence and float(sentence.split("sure to ")[1].split(" cm")[0]) < 1.0
    assert any("the sweeps do not tell which way the LiDAR turns" in one for one in log.missing)


def test_depth_edges_fall_on_the_edges_of_the_images(log: KittiLog) -> None:
    """Shifted by 4 pixels to either side or by 50 ms, or mirrored, they fit less. The drive is too slow for 20 ms to tell: the
    vehicle goes 5 cm in that time, a pixel or less at most of the edges."""
    camera = log.drive.cameras["image_02"]
    frames = log.image_frames("image_02")
    edges = {frame: _depth_edges(log, frame) for frame in frames}
    gradients = {frame: np.abs(np.gradient(log.image("image_02", frame).mean(-1), axis=1)) for frame in frames}

    def agreement(shift: float, mirrored: bool = False, late_s: float = 0.0) -> float:
        found: list[list[FloatArray]] = [[], []]
        for frame in frames:
            pose = camera.world_from_camera.at(camera.time_s[frame] + late_s)
            for side, points in enumerate(edges[frame]):
                local = (points - pose[:3, 3]) @ pose[:3, :3] * np.array([-1.0 if mirrored else 1.0, 1.0, 1.0])
                u, v, ahead = camera.model.project(local)
                with np.errstate(invalid="ignore"):
                    inside = ahead & (u > 9) & (u < camera.model.width - 9) & (v > 1) & (v < camera.model.height - 1)
                gradient = gradients[frame][v[inside].astype(int), (u[inside] + shift).astype(int)]
                found[side].append(np.minimum(gradient, 20))
        return float(np.mean([np.concatenate(side).mean() for side in found]))

    own = agreement(0)
    assert own > 1.02 * max(agreement(4), agreement(-4))
    assert own > 1.01 * max(agreement(0, late_s=0.05), agreement(0, late_s=-0.05))
    assert own > 1.3 * max(agreement(8), agreement(-8), agreement(0, mirrored=True))


def _depth_edges(log: KittiLog, frame: int) -> tuple[FloatArray, FloatArray]:
    """Returns with a farther one to their left, and to their right, on their ring: points (N, 3) of the world."""
    sweep = log.sweep(LIDAR, frame)
    depth = np.linalg.norm(sweep.points - sweep.origins, axis=1)
    same = (np.diff(sweep.ring) == 0) & (sweep.ring[1:] >= 0)
    jump, near = np.diff(depth), (depth > 4) & (depth < 40)
    left, right = np.append(same & (jump > 1.5), False), np.append(False, same & (jump < -1.5))
    return sweep.points[left & near], sweep.points[right & near]


def test_drops_are_cells_that_were_fired(log: KittiLog) -> None:
    """The sensor fires some 2100 times a turn at uneven steps, so of empty cells most are drops or the sky, and few lie between
    two returns of a wall."""
    grid = log.sweep_grid(LIDAR, 0)
    dropped = ~grid.returned & ~grid.blocked
    between = dropped & np.roll(grid.returned, 1, 1) & np.roll(grid.returned, -1, 1)
    near = np.abs(np.roll(grid.depth_m, 1, 1) - np.roll(grid.depth_m, -1, 1)) < 0.1
    assert (between & near).mean() < 0.01
    assert 0.05 < dropped.mean() < 0.3


def test_none_of_its_values_is_doubted(log: KittiLog) -> None:
    assert doubts(log) == []
