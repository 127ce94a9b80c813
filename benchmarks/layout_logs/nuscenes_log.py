"""The recording as a scene of nuScenes: points and drops in the sensor's frame at the sweep's end, boxes twice a second."""

from __future__ import annotations

from pathlib import Path

import kitti_street as kitti
import numpy as np
import nuscenes_street as nuscenes
from nuscenes_tables import Tables
from scipy.spatial.transform import Rotation

from .recording import CAMERA, COLUMNS, TURN_S, Recording

KEY_EVERY = 5
"""Two key frames a second."""
AXES = Rotation.from_euler("z", -np.pi / 2)
"""The dataset's LiDAR axes (x right, y forward) in ours."""
LAST_COLUMN_S = TURN_S / (2 * COLUMNS)
"""A sweep is stamped when its last column is fired, which is the middle of that column's time."""


def write_nuscenes(recording: Recording, root: Path, turned: Rotation | None = None) -> Path:
    """Write the recording; gives the dataset's path. ``turned``: the street's world in the map, as it is by default."""
    turn, place = Rotation.from_euler("z", kitti.LIDAR_YAW) * AXES, kitti.LIDAR_PLACE
    made = nuscenes.NuscenesStreet(recording.street, root, lidar_place=place, lidar_turn=turn, farthest_m=np.inf)
    the_map = Rotation.identity() if turned is None else turned
    tables, drive = Tables(), recording.drive
    lidar = tables.sensor("LIDAR_TOP", place.tolist(), _wxyz(turn))
    model = drive.cameras[CAMERA].model
    mount = np.linalg.solve(drive.world_from_ego.at(0.0), drive.cameras[CAMERA].world_from_camera.at(0.0))
    # the matrix counts pixels from the first one's centre
    matrix = [[model.fx, 0.0, model.cx - 0.5], [0.0, model.fy, model.cy - 0.5], [0.0, 0.0, 1.0]]
    camera = tables.sensor("CAM_FRONT", mount[:3, 3].tolist(), _wxyz(Rotation.from_matrix(mount[:3, :3])), matrix)
    sample = ""
    for frame in drive.frames:
        end_us = stamp(drive.time_s[frame] - LAST_COLUMN_S)
        key = frame % KEY_EVERY == 0 or frame == drive.frames[-1]
        folder = "samples" if key else "sweeps"
        _keep_sweep(recording, made, frame)
        file = f"{folder}/LIDAR_TOP/n015__LIDAR_TOP__{end_us}.pcd.bin"
        _write_sweep(recording, made, frame, root / file)
        if key:
            sample = tables.sample(end_us)
            _write_boxes(made, tables, sample, frame, the_map)
        tables.capture(sample, lidar, end_us, file, _pose(made, end_us, the_map), key)
        image_us = stamp(drive.cameras[CAMERA].time_s[frame])
        file = f"{folder}/CAM_FRONT/n015__CAM_FRONT__{image_us}.jpg"
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).write_bytes(recording.images[frame])
        pose = _pose(made, image_us, the_map)
        tables.capture(sample, camera, image_us, file, pose, key, (model.width, model.height))
    tables.write(root / "v1.0-mini")
    return root


def stamp(time_s: float) -> int:
    """The dataset's whole microseconds."""
    return nuscenes.START_US + round(time_s * 1e6)


def _keep_sweep(recording: Recording, made: nuscenes.NuscenesStreet, frame: int) -> None:
    """What boxes are written from: the columns' times, and the rings' directions, the lowest first."""
    sweep = recording.sweeps[frame]
    made.time_s.append(sweep.time_s[0])
    made.directions.append(sweep.directions[::-1])


def _write_sweep(recording: Recording, made: nuscenes.NuscenesStreet, frame: int, path: Path) -> None:
    sweep = recording.sweeps[frame]
    points = sweep.origins + sweep.directions * sweep.depth_m[..., None].astype(np.float64)
    turned, place = made.lidar(sweep.time_s[0, -1:])
    compensated = turned[0].inv().apply((points - place[0]).reshape(-1, 3)).reshape(points.shape)[::-1]
    intensity = np.rint(255 * sweep.intensity[::-1])
    ring = np.broadcast_to(np.arange(len(intensity))[:, None], intensity.shape)
    table = np.concatenate([compensated, intensity[..., None], ring[..., None]], -1).transpose(1, 0, 2)
    path.parent.mkdir(parents=True, exist_ok=True)
    table.astype("<f4").tofile(path)


def _write_boxes(made: nuscenes.NuscenesStreet, tables: Tables, sample: str, frame: int, the_map: Rotation) -> None:
    """Boxes of a key frame, which the tests' writer places in its own map."""
    first = len(tables.rows["sample_annotation"])
    nuscenes.write_boxes(made, tables, sample, frame)
    back = nuscenes.MAP[0].inv()
    for row in tables.rows["sample_annotation"][first:]:
        street = back.apply(np.array(row["translation"]) - nuscenes.MAP[1])
        row["translation"] = (the_map.apply(street) + nuscenes.MAP[1]).tolist()
        row["rotation"] = _wxyz(the_map * back * Rotation.from_quat(np.roll(row["rotation"], -1)))


def _pose(made: nuscenes.NuscenesStreet, stamp_us: int, the_map: Rotation) -> tuple[list[float], list[float]]:
    turned, place = made.ego(np.array([(stamp_us - nuscenes.START_US) * 1e-6]))
    return (the_map.apply(place[0]) + nuscenes.MAP[1]).tolist(), _wxyz(the_map * turned[0])


def _wxyz(rotation: Rotation) -> list[float]:
    return [float(value) for value in np.roll(rotation.as_quat(), 1)]
