"""Writes Argoverse 2's sensor dataset: sweeps and images one by one, then poses, calibration and annotations.

Points are moved to their sweep's timestamp, its start, as if all stood still, in the vehicle's frame. They are float32, which the
dataset's tools read as well as its own float16, and which keeps them to a hundredth of a millimetre.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...data.log import Log, Sweep
from ...errors import OutputError
from ...files import write_file
from ...geometry import FloatArray, invert_pose, points_in_box, quaternion_from_matrix, transform_points
from ...json_file import json_bytes
from ...sensors.lidar import column_times
from ...world.box_tracks import box_poses
from ...world.drive import Lidar
from ..common.arrow import feather_bytes
from ..common.rigs import LayoutCamera, RigLayout, RigRecording, image_part, nearest_rings
from ..common.writer import SCRATCH, Tick, WritePlan, WriterPart
from .files import QUATERNION, TRANSLATION
from .read import LASERS_EACH, LIDARS

SPLIT = "val"
EPOCH_NS = 1_500_000_000 * 10**9
"""The dataset's time, nanoseconds, of a drive's 0 s."""
CAMERAS = {
    "ring_front_center": 0.0, "ring_front_left": 45.0, "ring_front_right": -45.0, "ring_side_left": 99.0,
    "ring_side_right": -99.0, "ring_rear_left": 153.0, "ring_rear_right": -153.0,
}  # fmt: skip
"""The dataset's cameras and the headings in which they look, degrees."""
FARTHEST_DEG = 35.0
"""A camera that looks further from all of them has a name of its own."""
CITY = "XXX"
"""In the name of the map, which is empty, where the dataset has the city's."""
MOST_LASERS = 256
EARLIER = 0.1
"""By which share of a sweep its timestamp is before its first column."""


class Argoverse2LogWriter:
    """Plans logs in the layout of Argoverse 2's sensor dataset."""

    name = "argoverse2"
    about = "Argoverse 2 sensor dataset, one log, one LiDAR (needs pyarrow)"
    version = 1

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the log. Raises `OutputError` without a LiDAR that turns, or for one that does not ride on the vehicle;
        ModuleNotFoundError where pyarrow is not installed."""
        import pyarrow  # noqa: F401

        recording = RigRecording.plan(log, path, LAYOUT)
        losses = [*recording.losses, *recording.camera_losses, *_losses(recording.lidar)]
        folder = _folder(recording)
        parts = [_sweep_part(recording, frame) for frame in recording.sweeps]
        for camera in recording.cameras:
            images = f"{folder}/sensors/cameras/{camera.channel}"
            parts += [image_part(log, camera, at, path, f"{images}/{stamp}.jpg") for at, stamp in camera.stamps.items()]
        return WritePlan(tuple(filter(None, losses)), parts, lambda: _finish(recording), folder)


def _folder(recording: RigRecording) -> str:
    return f"{SPLIT}/{recording.name or 'log'}"


def _own_channel(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)


def stamp_ns(time_s: float) -> int:
    """Return a time of the drive as the dataset's stamp."""
    return round(time_s * 1e9) + EPOCH_NS


def seconds(stamp: int) -> float:
    """Return the drive's time of a stamp."""
    return (stamp - EPOCH_NS) * 1e-9


def _start_s(lidar: Lidar, frame: int) -> float:
    """A sweep's timestamp, from which returns count: recorded ones are fired a little beside their columns' times."""
    return float(column_times(lidar, lidar.time_s[frame]).min()) - EARLIER * lidar.model.sweep_s


LAYOUT = RigLayout("Argoverse 2", "argoverse2", CAMERAS, FARTHEST_DEG, _own_channel, stamp_ns, seconds, _start_s)


def _losses(lidar: Lidar) -> list[str]:
    said = ["the map is empty", "shutters, dropped rays and the beam table are lost"]
    if lidar.model.beams > len(LIDARS) * LASERS_EACH:
        said.append(
            f"{lidar.sensor_id}: has {lidar.model.beams} beams; readers that know the dataset's two LiDARs of "
            f"{LASERS_EACH} pass over all but the first {len(LIDARS) * LASERS_EACH}"
        )
    elif lidar.model.beams > LASERS_EACH:
        said.append(f"{lidar.sensor_id}: its beams are those of two LiDARs at one place, {' and '.join(LIDARS)}")
    return said


def _sweep_part(recording: RigRecording, frame: int) -> WriterPart:
    stamp = recording.sweeps[frame]
    files = (f"{SCRATCH}/points/{stamp}.json", f"{_folder(recording)}/sensors/lidar/{stamp}.feather")

    def write(tick: Tick) -> None:
        sweep = recording.log.sweep(recording.lidar.sensor_id, frame)
        actors, poses = box_poses(recording.drive, recording.lidar, frame)
        counts = {
            actor.uid: int(points_in_box(sweep.points, pose, actor.size_m).sum())
            for actor, pose in zip(actors, poses, strict=True)
        }
        write_file(recording.root / files[0], json_bytes(counts))
        ego = recording.drive.world_from_ego.at(seconds(stamp))
        write_file(recording.root / files[1], feather_bytes(sweep_table(sweep, ego, stamp, recording.lidar)))
        tick()

    return WriterPart(files, write)


def sweep_table(sweep: Sweep, world_from_ego: FloatArray, stamp: int, lidar: Lidar) -> dict[str, Any]:
    """Return the columns of a sweep's table: its strongest returns in the order of time, in the vehicle's frame at the stamp."""
    offset = np.rint((sweep.time_s - seconds(stamp)) * 1e9).astype(np.int64)
    if len(offset) and offset.min() < 0:
        raise OutputError(
            f"{lidar.sensor_id}: a return is {-1e-6 * offset.min():.1f} ms before its sweep, and Argoverse 2 counts from there"
        )
    poses = lidar.world_from_lidar.at(sweep.time_s)
    local = np.einsum("nji,nj->ni", poses[:, :3, :3], sweep.points - poses[:, :3, 3])
    ring = nearest_rings(sweep.ring, local, lidar)
    written = ring < MOST_LASERS
    if sweep.rank is not None:
        written &= sweep.rank == 0
    order = np.flatnonzero(written)
    order = order[np.lexsort((ring[order], offset[order]))]
    points = transform_points(invert_pose(world_from_ego), sweep.points[order])
    return {
        **{axis: points[:, at].astype(np.float32) for at, axis in enumerate("xyz")},
        "intensity": np.clip(np.rint(255 * sweep.intensity[order]), 0, 255).astype(np.uint8),
        "laser_number": ring[order].astype(np.uint8),
        "offset_ns": offset[order].astype(np.int32),
    }


def _finish(recording: RigRecording) -> None:
    folder, drive = recording.root / _folder(recording), recording.drive
    stamps = {*recording.sweeps.values(), *(stamp for camera in recording.cameras for stamp in camera.stamps.values())}
    # to the last sweep's end, and the vehicle's own poses in between
    stamps.add(max(recording.sweeps.values()) + round(recording.lidar.model.sweep_s * 1e9))
    first, last = min(stamps), max(stamps)
    stamps |= {stamp for stamp in map(stamp_ns, drive.world_from_ego.times_s.tolist()) if first < stamp < last}
    every = sorted(stamps)
    poses = drive.world_from_ego.at(np.array([seconds(stamp) for stamp in every]))
    poses[:, :3, 3] += drive.world_origin
    write_file(
        folder / "city_SE3_egovehicle.feather",
        feather_bytes({"timestamp_ns": np.array(every, np.int64), **_pose_columns(poses)}),
    )
    halves = LIDARS if recording.lidar.model.beams > LASERS_EACH else LIDARS[:1]
    mounts = {camera.channel: camera.mount for camera in recording.cameras} | dict.fromkeys(halves, recording.mount)
    write_file(
        folder / "calibration/egovehicle_SE3_sensor.feather",
        feather_bytes({"sensor_name": list(mounts), **_pose_columns(np.array(list(mounts.values())))}),
    )
    write_file(folder / "calibration/intrinsics.feather", feather_bytes(_intrinsics(recording.cameras)))
    write_file(folder / "annotations.feather", feather_bytes(_annotations(recording)))
    name = folder.name
    empty: dict[str, dict[str, Any]] = {"pedestrian_crossings": {}, "lane_segments": {}, "drivable_areas": {}}
    write_file(folder / f"map/log_map_archive_{name}____{CITY}_city_00000.json", json.dumps(empty).encode())


def _intrinsics(cameras: Sequence[LayoutCamera]) -> dict[str, Any]:
    models = [camera.model for camera in cameras]
    return {
        "sensor_name": [camera.channel for camera in cameras],
        **{
            f"{name}_px": np.array([getattr(model, name) for model in models], float)
            for name in ("fx", "fy", "cx", "cy")
        },
        **{name: np.zeros(len(models)) for name in ("k1", "k2", "k3")},
        "height_px": np.array([model.height for model in models], np.int64),
        "width_px": np.array([model.width for model in models], np.int64),
    }


def _annotations(recording: RigRecording) -> dict[str, Any]:
    """Boxes in the vehicle's frame at their sweep's stamp, each where it was in the world as the beams passed it."""
    rows: dict[str, list[Any]] = {name: [] for name in ("timestamp_ns", "track_uuid", "category", "num_interior_pts")}
    poses, sizes = [], []
    for frame, stamp in recording.sweeps.items():
        counts: Mapping[str, int] = json.loads((recording.root / f"{SCRATCH}/points/{stamp}.json").read_bytes())
        ego_from_world = invert_pose(recording.drive.world_from_ego.at(seconds(stamp)))
        for actor, pose in zip(*box_poses(recording.drive, recording.lidar, frame), strict=True):
            row = (stamp, actor.uid, actor.label, counts.get(actor.uid, 0))
            for name, value in zip(rows, row, strict=True):
                rows[name].append(value)
            poses.append(ego_from_world @ pose)
            sizes.append(actor.size_m)
    size = np.array(sizes, float).reshape(-1, 3)
    return {
        "timestamp_ns": np.array(rows["timestamp_ns"], np.int64),
        "track_uuid": rows["track_uuid"],
        "category": rows["category"],
        **{name: size[:, at] for at, name in enumerate(("length_m", "width_m", "height_m"))},
        **_pose_columns(np.array(poses).reshape(-1, 4, 4)),
        "num_interior_pts": np.array(rows["num_interior_pts"], np.int64),
    }


def _pose_columns(poses: FloatArray) -> dict[str, FloatArray]:
    quaternions = quaternion_from_matrix(poses[:, :3, :3]).reshape(-1, 4)
    columns = dict(zip(QUATERNION, quaternions.T, strict=True))
    return columns | dict(zip(TRANSLATION, poses[:, :3, 3].T, strict=True))
