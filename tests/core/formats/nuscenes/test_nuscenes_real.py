"""The reader of nuScenes on one real moment, for which tables are written here; skipped where it is absent.

UNISIM_NUSCENES names a folder with the sweep, the images and a JSON file of their calibration.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from nuscenes_tables import Tables
from scipy.spatial.transform import Rotation

from unisim_blender.core.data.values import doubts
from unisim_blender.core.formats.nuscenes.columns import column_times, read_columns, undone
from unisim_blender.core.formats.nuscenes.read import NuscenesLog
from unisim_blender.core.formats.nuscenes.scene import LIDAR
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, points_in_box

ROOT = Path(os.environ.get("UNISIM_NUSCENES", Path(__file__).parents[5] / "shared/data/nuscenes"))
pytestmark = pytest.mark.skipif(
    not list(ROOT.glob("*LIDAR_TOP*.pcd.bin")), reason=f"no real sweep in {ROOT}; set UNISIM_NUSCENES to its folder"
)
CLASSES = (
    *(
        "vehicle.car",
        "vehicle.truck",
        "vehicle.trailer",
        "vehicle.bus.rigid",
        "vehicle.construction",
        "vehicle.bicycle",
    ),
    *("vehicle.motorcycle", "human.pedestrian.adult", "movable_object.trafficcone", "movable_object.barrier"),
)


def _pose(matrix: FloatArray) -> tuple[list[float], list[float]]:
    turned = Rotation.from_matrix(matrix[:3, :3])
    return matrix[:3, 3].tolist(), [float(value) for value in np.roll(turned.as_quat(), 1)]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> NuscenesLog:
    """The moment as a scene of one key frame; where the vehicle was at each image follows from how the LiDAR saw the camera."""
    root = tmp_path_factory.mktemp("nuscenes")
    (document,) = ROOT.glob("*.json")
    moment = json.loads(document.read_text())["data_list"][0]
    map_from_ego = np.array(moment["ego2global"])
    ego_from_lidar = np.array(moment["lidar_points"]["lidar2ego"])
    (points,) = ROOT.glob("*LIDAR_TOP*.pcd.bin")
    stamp = int(points.name.split("__")[-1].split(".")[0])
    tables = Tables()
    sample = tables.sample(stamp)
    lidar = tables.sensor(LIDAR, *_pose(ego_from_lidar))
    file = f"samples/{LIDAR}/{points.name}"
    _link(points, root / file)
    tables.capture(sample, lidar, stamp, file, _pose(map_from_ego), True)
    for name, image in moment["images"].items():
        (picture,) = ROOT.glob(f"*__{name}__*.jpg")
        ego_from_camera, camera_from_lidar = np.array(image["cam2ego"]), np.array(image["lidar2cam"])
        then = map_from_ego @ ego_from_lidar @ np.linalg.inv(camera_from_lidar) @ np.linalg.inv(ego_from_camera)
        sensor = tables.sensor(name, *_pose(ego_from_camera), image["cam2img"])
        at = int(picture.name.split("__")[-1].split(".")[0])
        _link(picture, root / f"samples/{name}/{picture.name}")
        tables.capture(sample, sensor, at, f"samples/{name}/{picture.name}", _pose(then), True, (1600, 900))
    for box in moment["instances"]:
        x, y, z, length, width, height, yaw = box["bbox_3d"]
        local = np.eye(4)
        local[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
        local[:3, 3] = x, y, z + height / 2
        place, rotation = _pose(map_from_ego @ ego_from_lidar @ local)
        instance = tables.instance(CLASSES[box["bbox_label"]])
        tables.box(sample, instance, place, rotation, [width, length, height])
    tables.write(root / "v1.0-mini")
    log = open_log(root)
    assert isinstance(log, NuscenesLog)
    return log


def _link(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.symlink_to(source)


def _spread_deg(local: FloatArray, used: np.ndarray) -> float:  # type: ignore[type-arg]
    elevation = np.degrees(np.arctan2(local[..., 2], np.hypot(local[..., 0], local[..., 1])))
    return float(np.median([elevation[ring, used[ring]].std() for ring in range(32)]))


def test_undone_motion_puts_points_on_the_beams(log: NuscenesLog) -> None:
    lidar, path = log.drive.lidars[LIDAR], log._sweeps[0]
    columns = read_columns(path)
    time_s = column_times(columns.count, 0.0, lidar.model.sweep_s)
    local = undone(columns, time_s, 0.0, lidar.world_from_lidar)
    used = ~columns.dropped & ~columns.own & (np.linalg.norm(local, axis=-1) > 3)
    assert _spread_deg(local, used) <= 0.03
    assert _spread_deg(columns.points, used) > 0.1
    levels = np.degrees(lidar.model.elevation_rad)
    np.testing.assert_allclose(levels, 32 / 3 - np.arange(32) * 4 / 3, atol=0.15)


def test_drops_lie_on_the_sensors_way(log: NuscenesLog) -> None:
    """At 9 m/s for a twentieth of a second; the vehicle's poses say the same."""
    sweep = log.sweep(LIDAR, 0)
    assert sweep.drops is not None and 4300 < len(sweep.drops.time_s) < 4500
    way = sweep.drops.origins[np.argsort(sweep.drops.time_s)]
    assert np.linalg.norm(way[-1] - way[0]) == pytest.approx(0.452, abs=0.005)
    poses = log.drive.lidars[LIDAR].world_from_lidar.at(sweep.drops.time_s)
    assert np.linalg.norm(sweep.drops.origins - poses[:, :3, 3], axis=1).max() < 0.02


def test_the_roof_is_left_out(log: NuscenesLog) -> None:
    sweep = log.sweep(LIDAR, 0)
    distance = np.linalg.norm(sweep.points - sweep.origins, axis=1)
    assert 25_000 < len(distance) < 27_500 and (distance < 1.0).sum() < 40
    grid = log.sweep_grid(LIDAR, 0)
    assert grid.blocked.sum() > 3000 and grid.returned.sum() == len(distance)


def test_returns_lie_in_boxes(log: NuscenesLog) -> None:
    """Of near people and vehicles nine in ten hold returns; mirrored or shifted by 2 m, boxes hold far fewer."""
    sweep = log.sweep(LIDAR, 0)
    near = []
    for actor in log.drive.actors.values():
        pose = actor.world_from_actor.at(0.0)
        if actor.label.startswith(("human", "vehicle")) and np.linalg.norm(pose[:3, 3]) < 25:
            near.append((pose, actor.size_m))
    held = np.array([points_in_box(sweep.points, pose, size).sum() for pose, size in near])
    assert len(near) >= 10 and (held > 0).mean() > 0.9 and held.max() > 200
    aside = [(np.array(pose), size) for pose, size in near]
    for pose, _ in aside:
        pose[:2, 3] += 2.0
    assert sum(points_in_box(sweep.points, pose, size).sum() for pose, size in aside) < 0.7 * held.sum()


def test_depth_edges_fall_on_the_edges_of_the_images(log: NuscenesLog) -> None:
    """Shifted by 4 pixels or 20 ms, or mirrored, they fit less."""
    sweep = log.sweep(LIDAR, 0)
    grid = log.sweep_grid(LIDAR, 0)
    depth = np.where(grid.returned, grid.depth_m, np.inf)
    beside = np.maximum(np.roll(depth, 1, 1), np.roll(depth, -1, 1))
    edge = grid.returned & (depth > 3) & (depth < 40) & (beside > depth + 1.5)
    points = (grid.origins + grid.directions * grid.depth_m[..., None])[edge]
    assert len(points) > 300 and len(sweep.points) > len(points)
    gradients = {
        name: np.abs(np.gradient(log.image(name, log.image_frames(name)[0]).mean(-1), axis=1))
        for name in log.drive.cameras
    }

    def agreement(shift: float = 0, late_s: float = 0, mirrored: bool = False) -> float:
        found = []
        for name, camera in log.drive.cameras.items():
            pose = camera.world_from_camera.at(camera.time_s[log.image_frames(name)[0]] + late_s)
            local = (points - pose[:3, 3]) @ pose[:3, :3] * np.array([-1.0 if mirrored else 1.0, 1.0, 1.0])
            u, v, ahead = camera.model.project(local)
            with np.errstate(invalid="ignore"):
                seen = ahead & (u > 20) & (u < 1580) & (v > 1) & (v < 820)
            found.append(np.minimum(gradients[name][v[seen].astype(int), (u[seen] + shift).astype(int)], 20))
        return float(np.concatenate(found).mean())

    own = agreement()
    assert own > max(agreement(shift=4), agreement(shift=-4), agreement(late_s=0.02), agreement(late_s=-0.02))
    assert own > 1.05 * max(agreement(shift=8), agreement(shift=-8), agreement(late_s=0.05), agreement(late_s=-0.05))
    assert own > 1.2 * agreement(mirrored=True)


def test_none_of_its_values_is_doubted(log: NuscenesLog) -> None:
    assert doubts(log) == []
