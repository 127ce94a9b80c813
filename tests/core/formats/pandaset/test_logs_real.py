"""The reader on a real log, with pandas as the oracle; skipped where the log is absent
(UNISIM_PANDASET names its folder)."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.core.data.log import Log, Sweep, extras_of
from unisim_blender.core.formats.pandaset.safe_pickle import read_table
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.sensors.camera import camera_rays, line_times
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.world.drive import Actor, Camera
from unisim_blender.core.world.light import direction_to

pandas = pytest.importorskip("pandas")
ROOT = Path(os.environ.get("UNISIM_PANDASET", Path(__file__).parents[5] / "shared/data/pandaset/002"))
pytestmark = pytest.mark.skipif(
    not ROOT.is_dir(), reason=f"no real log at {ROOT}; set UNISIM_PANDASET to a PandaSet sequence"
)
DRIVING = 50


@pytest.fixture(scope="module")
def log() -> Log:
    return open_log(ROOT)


@pytest.fixture(scope="module")
def sweep(log: Log) -> Sweep:
    return log.sweep("pandar64", DRIVING)


@pytest.mark.parametrize("folder", ["lidar", "annotations/cuboids", "annotations/semseg"])
def test_tables_are_those_that_pandas_reads(folder: str) -> None:
    files = sorted((ROOT / folder).glob("*.pkl.gz"))
    for path in files[:: max(1, len(files) // 5)]:
        table, frame = read_table(path), pandas.read_pickle(path)
        assert set(table) == set(frame.columns)
        for name in frame.columns:
            absent = pandas.isna(frame[name].to_numpy())
            np.testing.assert_array_equal(pandas.isna(table[name]), absent)
            np.testing.assert_array_equal(table[name][~absent], frame[name].to_numpy()[~absent])


def test_actors_are_the_cuboids_without_twins(log: Log) -> None:
    kept: dict[str, list[float]] = {}
    for path in (ROOT / "annotations/cuboids").glob("*.pkl.gz"):
        frame = pandas.read_pickle(path)
        for row in frame[frame["cuboids.sensor_id"] != 1].to_dict("records"):
            kept.setdefault(row["uuid"], []).append(row["dimensions.y"])
    assert set(kept) == set(log.drive.actors)
    for uid, lengths in kept.items():
        assert log.drive.actors[uid].size_m[0] == pytest.approx(np.median(lengths))


def test_poses_are_those_of_the_devkits_files(log: Log) -> None:
    cameras = log.drive.cameras
    forward = {name: camera.world_from_camera.at(5.0)[:3, 2] for name, camera in cameras.items()}
    ego = log.drive.world_from_ego.at(5.0)
    assert forward["front_camera"] @ ego[:3, 0] > 0.99 and forward["back_camera"] @ ego[:3, 0] < -0.99
    assert forward["left_camera"] @ ego[:3, 1] > 0.95 and forward["right_camera"] @ ego[:3, 1] < -0.95
    assert ego[2, 2] > 0.99
    np.testing.assert_array_equal(log.drive.world_from_ego.positions[0], 0)


def test_ego_drives_the_way_it_looks(log: Log) -> None:
    a, b = log.drive.world_from_ego.at(np.array([5.0, 5.5]))
    step = b[:3, 3] - a[:3, 3]
    assert np.linalg.norm(step) > 1
    assert step @ a[:3, 0] / np.linalg.norm(step) > 0.99


def test_undone_motion_puts_points_on_the_beams(log: Log, sweep: Sweep) -> None:
    """At the wrong pose, that of the frame, the same points miss the beams by three times as much."""
    lidar = log.drive.lidars["pandar64"]
    assert (sweep.ring >= 0).mean() > 0.999

    def misses(poses: FloatArray) -> float:
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], sweep.points - poses[:, :3, 3])
        far = np.linalg.norm(local, axis=1) > 4
        elevation = np.arctan2(local[:, 2], np.hypot(local[:, 0], local[:, 1]))
        nearest = np.abs(elevation[:, None] - lidar.model.elevation_rad).min(1)
        return float(np.degrees(np.mean(nearest[far])))

    own = misses(lidar.world_from_lidar.at(sweep.time_s))
    rigid = misses(np.broadcast_to(lidar.world_from_lidar.at(log.drive.time_s[DRIVING]), (len(sweep.points), 4, 4)))
    assert own < 0.05 < rigid


def test_cells_hold_one_return_each_and_their_own_time(log: Log, sweep: Sweep) -> None:
    cells = sweep.ring.astype(np.int64) * 1800 + sweep.column
    assert len(np.unique(cells)) / len(cells) > 0.995
    rays = lidar_rays(log.drive.lidars["pandar64"], log.drive.lidars["pandar64"].time_s[DRIVING])
    late = sweep.time_s - rays.time_s[sweep.ring, sweep.column]
    late -= 0.1 * np.rint(late / 0.1)  # near the sweep's seam the cell belongs to the turn before or after
    assert np.abs(late).max() < 0.5e-3


def test_grid_has_few_drops_among_cells_that_look_down(log: Log) -> None:
    grid = log.sweep_grid("pandar64", DRIVING)
    assert 0.9 < grid.returned.mean() < 0.95
    assert 0.005 < grid.blocked.mean() < 0.03 and not (grid.blocked & grid.returned).any()
    down = grid.model.elevation_rad < np.radians(-10)
    assert (grid.returned | grid.blocked)[down].mean() > 0.97
    table = lidar_rays(log.drive.lidars["pandar64"], log.drive.lidars["pandar64"].time_s[DRIVING])
    cosine = np.sum(table.directions * grid.directions, -1)[grid.returned]
    assert np.degrees(np.arccos(np.minimum(np.median(cosine), 1))) < 0.1


def test_moving_cars_hold_their_points(log: Log) -> None:
    """Boxes are where the beams met the cars; half a sweep earlier or later they are not."""

    def share_inside(shift_s: float) -> float:
        shares = []
        for frame in (40, 50, 60):
            sweep = log.sweep("pandar64", frame)
            shares += [
                _inside(actor, sweep, shift_s) for actor in _fast_cars(log, frame) if _near(actor, sweep).sum() > 60
            ]
        assert len(shares) > 10
        return float(np.mean(shares))

    assert share_inside(0) > 0.75
    assert share_inside(0) > share_inside(0.05) + 0.1 and share_inside(0) > share_inside(-0.05) + 0.1


def _fast_cars(log: Log, frame: int) -> list[Actor]:
    time_s = log.drive.time_s[frame] - 0.05
    cars = [
        actor
        for actor in log.drive.actors.values()
        if actor.is_moving and actor.label == "Car" and actor.present(time_s)
    ]

    def speed(actor: Actor) -> float:
        a, b = actor.world_from_actor.at(np.array([time_s - 0.1, time_s + 0.1]))[:, :3, 3]
        return float(np.linalg.norm(b - a) / 0.2)

    return [actor for actor in cars if speed(actor) > 5]


def _near(actor: Actor, sweep: Sweep) -> NDArray[np.bool_]:
    centre = actor.world_from_actor.at(float(sweep.time_s.mean()))[:3, 3]
    return np.asarray((np.linalg.norm(sweep.points - centre, axis=1) < 4.5) & (sweep.semantic == 13))


def _inside(actor: Actor, sweep: Sweep, shift_s: float) -> float:
    near = _near(actor, sweep)
    poses = actor.world_from_actor.at(sweep.time_s[near] + shift_s)
    local = np.einsum("nji,nj->ni", poses[:, :3, :3], sweep.points[near] - poses[:, :3, 3])
    return float((np.abs(local) <= actor.size_m / 2).all(1).mean())


def test_images_are_as_large_as_their_cameras(log: Log) -> None:
    for name, camera in log.drive.cameras.items():
        image = log.image(name, log.image_frames(name)[0])
        assert image.shape == (camera.model.height, camera.model.width, 3) and image.std() > 20


def test_the_sun_stands_where_the_sky_is_brightest(log: Log) -> None:
    """In front of the left camera, behind the edge of a cloud."""
    sun, camera = extras_of(log).sun, log.drive.cameras["left_camera"]
    assert sun is not None and sun.deviation_deg < 1
    image = log.image("left_camera", 0).sum(-1)
    v, u = np.nonzero(image >= np.quantile(image, 0.9995))
    middle = np.median(u), np.median(v)
    brightest = camera_rays(camera, camera.time_s[0], *(np.array([[x + 0.5]]) for x in middle)).directions[0, 0]
    stated = direction_to(np.radians(sun.azimuth_deg), np.radians(sun.elevation_deg))
    assert np.degrees(np.arccos(brightest @ stated)) < 2.5


def test_depth_edges_fall_on_the_edges_of_images_taken_then(log: Log) -> None:
    """Of a camera that looks sideways: a fifth of an image's period earlier or later, 4 pixels aside, or mirrored, less fits,
    and half a period away nothing does."""
    camera = log.drive.cameras["left_camera"]

    def contrast(shift_s: float = 0, aside: float = 0, mirrored: bool = False) -> float:
        values = [_contrast_at_edges(log, camera, frame, shift_s, aside, mirrored) for frame in (62, 66, 70, 74, 78)]
        return float(np.mean(np.concatenate(values)))

    own = contrast()
    assert own > max(contrast(0.02), contrast(-0.02), contrast(aside=4), contrast(aside=-4))
    assert own > 1.25 * max(contrast(0.05), contrast(-0.05), contrast(mirrored=True))


def _contrast_at_edges(
    log: Log, camera: Camera, frame: int, shift_s: float, aside: float, mirrored: bool
) -> FloatArray:
    """The image's horizontal gradient where near returns beside far ones are seen, or so many pixels aside."""
    grid, model = log.sweep_grid("pandar64", frame), camera.model
    depth = np.where(grid.returned, grid.depth_m, np.inf)
    beside = np.maximum(np.roll(depth, 1, 1), np.roll(depth, -1, 1))
    edge = grid.returned & (depth > 3) & (depth < 40) & (beside > depth + 1.5)
    points = (grid.origins + grid.directions * grid.depth_m[..., None])[edge]
    gradient = np.abs(np.gradient(log.image(camera.sensor_id, frame).mean(-1), axis=1))
    v = np.full(len(points), model.height / 2)
    for _ in range(3):
        poses = camera.world_from_camera.at(line_times(camera, camera.time_s[frame], v) + shift_s)
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], points - poses[:, :3, 3])
        z = np.where(local[:, 2] > 1, local[:, 2], np.nan)
        u, v = (
            model.fx * (-local[:, 0] if mirrored else local[:, 0]) / z + model.cx + aside,
            model.fy * local[:, 1] / z + model.cy,
        )
        v = np.where(np.isfinite(v), v, -1.0)
    seen = (u >= 0) & (u < model.width) & (v >= 0) & (v < model.height)
    return np.asarray(np.minimum(gradient[v[seen].astype(int), u[seen].astype(int)], 12))
