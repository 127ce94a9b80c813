"""Plans a scene of nuScenes: sweeps and images one by one, then the tables.

A firing without a return lies where the sensor was. One that the vehicle itself blocks is a return from its roof.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...data.log import Log, SweepGrid
from ...files import write_file
from ...geometry import FloatArray, invert_pose
from ...json_file import json_bytes
from ...sensors.lidar import beam_directions, column_times
from ...world.box_tracks import box_poses, hidden_shares
from ...world.captures import US_PER_SECOND, microseconds
from ...world.drive import Actor, CameraModel, Lidar, LidarModel
from ..common.rigs import LayoutCamera, RigLayout, RigRecording, image_part, looking_time, mid_exposure_shutter
from ..common.sensor_file import LidarSetup, LogSetup, write_setup
from ..common.writer import SCRATCH, Tick, WritePlan, WriterPart
from .columns import BODY_MAX_M, BODY_MIN_M, OWN_FROM_DATASETS
from .scene import LIDAR, TableRow, attribute_of, chained, place_of, scene_name, token, visibility_of, write_tables

EPOCH_US = 1_500_000_000 * US_PER_SECOND
"""The dataset's time, microseconds, of a drive's 0 s."""
ROOF_M = 0.8
"""How far away the vehicle's roof is where it blocks a beam: nearer than the 1 m within which the dataset's tools leave out
points."""


def stamp_us(time_s: float) -> int:
    """Return a time of the drive as the dataset's stamp."""
    return microseconds(time_s) + EPOCH_US


def seconds(stamp: int) -> float:
    """Return the drive's time of a stamp."""
    return (stamp - EPOCH_US) / US_PER_SECOND


def _end_s(lidar: Lidar, frame: int) -> float:
    """Return when the last column of a frame's sweep is fired, by which it is stamped."""
    return float(column_times(lidar, lidar.time_s[frame])[-1])


def last_column_s(model: LidarModel) -> float:
    """Return how long after a frame's time the last column is fired."""
    end = -model.sweep_s * 0.5 / model.columns if model.column_time_s is None else float(model.column_time_s[-1])
    return model.time_offset_s + end


def sweep_file(grid: SweepGrid, lidar: Lidar, frame: int, end_s: float) -> bytes:
    """Return the file's bytes: x, y, z, intensity 0..255 and ring, float32, of beams x columns."""
    fired = column_times(lidar, lidar.time_s[frame])
    poses, end = lidar.world_from_lidar.at(fired), lidar.world_from_lidar.at(end_s)
    origins = poses[:, :3, 3]
    world = np.broadcast_to(origins, grid.directions.shape).copy()
    there = grid.returned
    world[there] = grid.origins[there] + grid.directions[there] * grid.depth_m[there, None].astype(np.float64)
    roof = grid.blocked & _hits_roof(lidar, frame)
    world[roof] = grid.origins[roof] + grid.directions[roof] * ROOF_M
    local = (world - end[:3, 3]) @ end[:3, :3] @ OWN_FROM_DATASETS
    beams, columns = there.shape
    table = np.zeros((columns, beams, 5), "<f4")
    # the dataset's ring 0 is the lowest
    table[..., :3] = local[::-1].transpose(1, 0, 2)
    table[..., 3] = 255 * grid.intensity[::-1].T
    table[..., 4] = np.arange(beams)
    return table.tobytes()


def _hits_roof(lidar: Lidar, frame: int) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Which cells (beams, columns) pass, ROOF_M away, the box that the dataset's returns from the roof lie in."""
    local: FloatArray = beam_directions(lidar.model_at(lidar.time_s[frame])) * ROOF_M
    return np.asarray(((local > BODY_MIN_M) & (local < BODY_MAX_M)).all(-1))


KEY_S = 0.5
"""From one key frame to the next."""
KEY_SLACK = 0.3
"""By which share of it key frames are nearer or further where images lie better then."""
SAME_S = 0.01
"""Images are as good as others that are by less than this nearer to the beams."""
APART_S = 0.05
"""Key images that are further from when the beams pass their view are told."""
NOT_WRITTEN = "no CAN bus is written, the map is an empty image and the location unknown"
CHANNELS = {
    "CAM_FRONT": 0.0, "CAM_FRONT_LEFT": 55.0, "CAM_FRONT_RIGHT": -55.0, "CAM_BACK_LEFT": 108.0,
    "CAM_BACK_RIGHT": -108.0, "CAM_BACK": 180.0,
}  # fmt: skip
"""The dataset's cameras and the headings in which they look, degrees."""
FARTHEST_DEG = 50.0
"""A camera that looks further from all of them has a channel of its own name."""


def _own_channel(name: str) -> str:
    return "CAM_" + "".join(letter if letter.isalnum() else "_" for letter in name.upper())


LAYOUT = RigLayout("nuScenes", "nuscenes", CHANNELS, FARTHEST_DEG, _own_channel, stamp_us, seconds, _end_s)


@dataclass
class _Scene(RigRecording):
    """A recording with its key frames."""

    @cached_property
    def keys(self) -> list[int]:
        """Frames of key frames: the first, one about each KEY_S later, and the last, so that boxes are of the whole drive.

        Of the sweeps about KEY_S later it is the one that images agree with best, where some have none of their time.
        """
        frames = sorted(self.sweeps, key=self.sweeps.__getitem__)
        stamps = np.array([self.sweeps[frame] for frame in frames]) * 1e-6
        step = float(np.median(np.diff(stamps))) if frames[1:] else KEY_S
        late = np.zeros(len(frames))
        for camera in self.cameras:
            apart = np.abs(self._exposed_s(camera) - self._passed_s(camera, frames)[:, None])
            late = np.maximum(late, np.minimum(apart.min(1), KEY_SLACK * KEY_S))
        chosen = [0]
        while True:
            after = stamps - stamps[chosen[-1]] - KEY_S
            following = np.flatnonzero(after > -step / 2)
            if not len(following):
                break
            near = np.flatnonzero(np.abs(after) <= KEY_SLACK * KEY_S)
            near = near if len(near) else following[:1]
            best = min(near.tolist(), key=lambda at: (round(float(late[at]) / SAME_S), abs(after[at]), at))
            chosen.append(best)
        keys = [frames[at] for at in chosen]
        return keys if keys[-1] == frames[-1] else [*keys, frames[-1]]

    def file(self, channel: str, stamp: int, is_key: bool) -> str:
        """Where a capture's file lies."""
        end = "pcd.bin" if channel == LIDAR else "jpg"
        return f"{'samples' if is_key else 'sweeps'}/{channel}/{self.name}__{channel}__{stamp}.{end}"

    def key_images(self, camera: LayoutCamera) -> dict[int, tuple[int, float]]:
        """By key frame, the frame of the image whose exposure is nearest to when the sweep's beams pass where the camera looks,
        as the dataset's own rig exposes it, and how many seconds are between them. An image is of one key frame."""
        frames = list(camera.stamps)
        apart = np.abs(self._exposed_s(camera) - self._passed_s(camera, self.keys)[:, None])
        pairs = sorted((float(apart[at, image]), at, image) for at, image in np.argwhere(apart <= KEY_S).tolist())
        images: dict[int, tuple[int, float]] = {}
        taken: set[int] = set()
        for between, at, image in pairs:
            if self.keys[at] not in images and image not in taken:
                images[self.keys[at]] = frames[image], between
                taken.add(image)
        return images

    def _exposed_s(self, camera: LayoutCamera) -> FloatArray:
        """The middles of a camera's exposures, in the order of its stamps."""
        return np.array([seconds(stamp) for stamp in camera.stamps.values()])

    def _passed_s(self, camera: LayoutCamera, frames: Sequence[int]) -> FloatArray:
        """When the beams of frames' sweeps pass where a camera looks."""
        ahead = (invert_pose(self.mount) @ camera.mount)[:3, 2]
        azimuth = float(np.arctan2(ahead[1], ahead[0]))
        return np.array([looking_time(self.lidar, frame, azimuth) for frame in frames])


class NuscenesLogWriter:
    """Plans datasets of one scene in nuScenes' layout."""

    name = "nuscenes"
    about = "nuScenes v1.0, one scene in v1.0-mini, one LiDAR"
    version = 3

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the scene. Raises `OutputError` without a LiDAR that turns, or for one that does not ride on the vehicle."""
        scene = _Scene.plan(log, path, LAYOUT)
        scene.name, lidar = scene.name or "scene", scene.lidar
        losses, name = [*scene.losses, NOT_WRITTEN, *scene.camera_losses], scene.name
        if name != scene_name(name):
            losses.append(
                f"the scene is called {scene_name(name)}, which predefined splits list; {name} is its description"
            )
        if lidar.model.beam_time_s is not None:
            late = 1e6 * float(np.ptp(lidar.model.beam_time_s))
            losses.append(f"{lidar.sensor_id}: beams of a column have one time; they were fired within {late:.0f} us")
        keys = scene.keys
        parts = [_sweep_part(scene, frame, frame in keys) for frame in sorted(scene.sweeps)]
        for camera in scene.cameras:
            key_images = scene.key_images(camera)
            losses.append(_key_images_sentence(camera, key_images, len(keys)))
            key = {image for image, _ in key_images.values()}
            for frame, stamp in camera.stamps.items():
                parts.append(image_part(log, camera, frame, path, scene.file(camera.channel, stamp, frame in key)))
        return WritePlan(tuple(filter(None, losses)), parts, lambda: _finish(scene))


def _key_images_sentence(camera: LayoutCamera, key_images: dict[int, tuple[int, float]], keys: int) -> str:
    """Return a sentence about a camera's key images; "" where all are exposed about when the beams pass."""
    said = []
    if len(key_images) < keys:
        said.append(f"{keys - len(key_images)} of {keys} key frames have no image")
    far = [apart for _, apart in key_images.values() if apart > APART_S]
    if far:
        said.append(
            f"{len(far)} of {len(key_images)} key images were exposed more than {1e3 * APART_S:.0f} ms (up to "
            f"{1e3 * max(far):.0f} ms) from when the LiDAR's beams passed their view: boxes of what moves are off by that"
        )
    return f"{camera.name}: {', and '.join(said)}" if said else ""


def _sweep_part(scene: _Scene, frame: int, is_key: bool) -> WriterPart:
    stamp = scene.sweeps[frame]
    files = [scene.file(LIDAR, stamp, is_key)]
    if is_key:
        files.insert(0, _measured_file(stamp))

    def write(tick: Tick) -> None:
        name, lidar = scene.lidar.sensor_id, scene.lidar
        grid = scene.log.sweep_grid(name, frame)
        if is_key:
            write_file(scene.root / files[0], json_bytes(_measured(grid, *_boxes(scene, frame))))
        write_file(scene.root / files[-1], sweep_file(grid, lidar, frame, seconds(stamp)))
        tick()

    return WriterPart(tuple(files), write)


def _measured(grid: SweepGrid, actors: list[Actor], poses: FloatArray) -> dict[str, tuple[int, str]]:
    """By uid, the returns in an actor's box, and the token of its visibility: of the level that beams towards it tell."""
    origins = grid.origins[grid.returned]
    points = origins + grid.directions[grid.returned] * grid.depth_m[grid.returned, None]
    sizes = np.array([actor.size_m for actor in actors]).reshape(-1, 3)
    shares, counts = hidden_shares(origins, points, poses, sizes)
    return {
        actor.uid: (count, visibility_of(share))
        for actor, count, share in zip(actors, counts.tolist(), shares.tolist(), strict=True)
    }


def _measured_file(stamp: int) -> str:
    return f"{SCRATCH}/points/{stamp}.json"


def _boxes(scene: _Scene, frame: int) -> tuple[list[Actor], FloatArray]:
    return box_poses(scene.drive, scene.lidar, frame)


def _finish(scene: _Scene) -> None:
    scene_token, log_token = token("scene", scene.name), token("log", scene.name)
    keys = scene.keys
    samples = chained(
        [
            {"token": token("sample", scene.name, scene.sweeps[key]), "timestamp": scene.sweeps[key],
             "scene_token": scene_token}
            for key in keys
        ]
    )  # fmt: skip
    rows: dict[str, list[TableRow]] = {
        "sample": samples, "sensor": [], "calibrated_sensor": [], "sample_data": [], "ego_pose": [],
        "scene": [
            {"token": scene_token, "log_token": log_token, "nbr_samples": len(keys), "name": scene_name(scene.name),
             "first_sample_token": samples[0]["token"], "last_sample_token": samples[-1]["token"],
             "description": scene.name}
        ],
    }  # fmt: skip
    of_keys = {key: sample["token"] for key, sample in zip(keys, samples, strict=True)}
    dataset_mount = scene.mount.copy()
    dataset_mount[:3, :3] = scene.mount[:3, :3] @ OWN_FROM_DATASETS
    key_sweeps = {key: key for key in keys}
    _captures(scene, rows, LIDAR, dataset_mount, None, scene.sweeps, key_sweeps, of_keys)
    for camera in scene.cameras:
        key_images = {key: image for key, (image, _) in scene.key_images(camera).items()}
        _captures(scene, rows, camera.channel, camera.mount, camera.model, camera.stamps, key_images, of_keys)
    rows |= _box_rows(scene, keys, of_keys)
    write_tables(scene.root, rows)
    write_setup(scene.root, _setup(scene))


def _captures(
    scene: _Scene,
    rows: dict[str, list[TableRow]],
    channel: str,
    mount: FloatArray,
    model: CameraModel | None,
    stamps: dict[int, int],
    key_captures: dict[int, int],
    of_keys: dict[int, str],
) -> None:
    """Add the rows of a sensor: itself, its calibration, its captures with the vehicle's poses."""
    sensor, calibration = token("sensor", channel), token("calibrated_sensor", scene.name, channel)
    rows["sensor"].append({"token": sensor, "channel": channel, "modality": "lidar" if model is None else "camera"})
    # the matrix counts pixels from the first one's centre
    matrix = (
        [] if model is None else [[model.fx, 0.0, model.cx - 0.5], [0.0, model.fy, model.cy - 0.5], [0.0, 0.0, 1.0]]
    )
    rows["calibrated_sensor"].append(
        {"token": calibration, "sensor_token": sensor, **place_of(mount), "camera_intrinsic": matrix}
    )
    key_stamps = np.array([scene.sweeps[key] for key in of_keys])
    tokens, keys = list(of_keys.values()), set(key_captures.values())
    sample_of = {capture: of_keys[key] for key, capture in key_captures.items()}
    data = []
    for frame in sorted(stamps, key=stamps.__getitem__):
        stamp, is_key = stamps[frame], frame in keys
        own = token("sample_data", scene.name, channel, stamp)
        pose = scene.drive.world_from_ego.at(seconds(stamp))
        pose[:3, 3] += scene.drive.world_origin
        rows["ego_pose"].append({"token": own, "timestamp": stamp, **place_of(pose)})
        nearest = tokens[int(np.abs(key_stamps - stamp).argmin())]
        data.append(
            {
                "token": own,
                "sample_token": sample_of.get(frame, nearest),
                "ego_pose_token": own,
                "calibrated_sensor_token": calibration,
                "timestamp": stamp,
                "fileformat": "pcd" if model is None else "jpg",
                "is_key_frame": is_key,
                "height": 0 if model is None else model.height,
                "width": 0 if model is None else model.width,
                "filename": scene.file(channel, stamp, is_key),
            }
        )
    rows["sample_data"] += chained(data)


def _box_rows(scene: _Scene, keys: list[int], of_keys: dict[int, str]) -> dict[str, list[TableRow]]:
    """Instances, categories, and the boxes of key frames, each where it was as the beams passed it."""
    of_actor: dict[str, list[TableRow]] = {}
    labels: dict[str, str] = {}
    for key in keys:
        measured = json.loads((scene.root / _measured_file(scene.sweeps[key])).read_bytes())
        actors, poses = _boxes(scene, key)
        for actor, pose in zip(actors, poses, strict=True):
            labels[actor.uid] = actor.label
            world = pose.copy()
            world[:3, 3] += scene.drive.world_origin
            length, width, height = np.asarray(actor.size_m).tolist()
            count, visibility = measured.get(actor.uid, (0, visibility_of(np.nan)))
            of_actor.setdefault(actor.uid, []).append(
                {
                    "token": token("sample_annotation", scene.name, actor.uid, scene.sweeps[key]),
                    "sample_token": of_keys[key],
                    "instance_token": actor.uid,
                    "visibility_token": visibility,
                    "attribute_tokens": attribute_of(actor.label, actor.is_moving),
                    **place_of(world),
                    "size": [width, length, height],
                    "num_lidar_pts": count,
                    "num_radar_pts": 0,
                }
            )
    instances = [
        {
            "token": uid,
            "category_token": token("category", labels[uid]),
            "nbr_annotations": len(there),
            "first_annotation_token": there[0]["token"],
            "last_annotation_token": there[-1]["token"],
        }
        for uid, there in of_actor.items()
    ]
    categories = [
        {"token": token("category", label), "name": label, "description": ""} for label in sorted(set(labels.values()))
    ]
    boxes = [row for there in of_actor.values() for row in chained(there)]
    return {"sample_annotation": boxes, "instance": instances, "category": categories}


def _setup(scene: _Scene) -> LogSetup:
    """Return the setup that the tables have no place for: frames' numbers, shutters, the beam table as the sweeps'
    stamps have it."""
    model, lidar = scene.lidar.model, scene.lidar
    late, first = last_column_s(model), seconds(min(scene.sweeps.values()))
    stamped = replace(model, time_offset_s=model.time_offset_s - late)
    phase = lidar.phase and replace(lidar.phase, times_s=lidar.phase.times_s + late - first)
    drive = scene.drive
    shutters = {camera.channel: mid_exposure_shutter(drive.cameras[camera.name]) for camera in scene.cameras}
    return LogSetup(
        name=scene.name,
        frames=tuple(sorted(scene.sweeps)),
        time_origin_s=first,
        world_origin=scene.drive.world_origin,
        shutters=shutters,
        lidars={LIDAR: LidarSetup(0, scene.mount, stamped, phase)},
    )
