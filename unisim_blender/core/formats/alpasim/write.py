"""Write a scene for AlpaSim's runtime: the zip file that it reads beside the renderer.

It has the recorded trajectories of the rig and of all actors, and the ground as a mesh. Poses and times are those that
`unisim serve` has: the world's, and microseconds from the log's first frame.
"""

from __future__ import annotations

import io
import json
import uuid
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ...files import write_file
from ...geometry import FloatArray, Trajectory
from ...world.captures import microseconds
from ...world.drive import Actor, Drive

SEQUENCE = "drive"
CELL_M, BESIDE_M = 1.0, 40.0
"""Edge of the ground's cells, and how far beside the recorded path it reaches."""
HEIGHT_M = 1.5
"""Of the ego vehicle's box, which no log has."""
ZIP_DATE = (2000, 1, 1, 0, 0, 0)
"""Of the members: the same scenario gives the same bytes."""
NO_MAP = "there is no map: AlpaSim takes the route from the recording, and scores nothing off the road"
GROUND_ALONE = "the mesh is the ground alone: nothing else stands in the physics"


class AlpaSimScene(Protocol):
    """A scene as it is served: ``drive`` with its edits and sensors, the trajectory of AlpaSim's rig, and sensors' mounts (4, 4)
    on the rig by their names."""

    @property
    def scene_id(self) -> str: ...
    @property
    def drive(self) -> Drive: ...
    @property
    def world_from_rig(self) -> Trajectory: ...
    @property
    def rig_from_sensor(self) -> Mapping[str, FloatArray]: ...


class VehicleSize(Protocol):
    """The recording vehicle's size, metres."""

    @property
    def length_m(self) -> float: ...
    @property
    def width_m(self) -> float: ...
    @property
    def rear_overhang_m(self) -> float: ...


def write(
    scene: AlpaSimScene, vehicle: VehicleSize, heights: Callable[[FloatArray], FloatArray], digest: str, folder: Path
) -> tuple[str, tuple[str, ...]]:
    """Write a scene into a folder; the file's name, and what is lost.

    ``heights`` gives the heights (N,) of points (N, 3) above the ground; ``digest`` is the scenario's.
    """
    ground = ground_mesh(scene, heights)
    members: dict[str, str | bytes] = {
        # JSON is YAML, too
        "metadata.yaml": _json(metadata(scene, digest)),
        "rig_trajectories.json": _json(rig_trajectories(scene, vehicle)),
        "sequence_tracks.json": _json(sequence_tracks(scene.drive)),
        "mesh.ply": ground,
        "mesh_ground.ply": ground,
    }
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name, ZIP_DATE), data)
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in scene.scene_id)
    write_file(folder / f"{name}.usdz", file.getvalue())
    return f"{name}.usdz", (NO_MAP, GROUND_ALONE)


def metadata(scene: AlpaSimScene, digest: str) -> dict[str, Any]:
    """Return what names the scene and its sensors."""
    times = [scene.drive.time_s[frame] for frame in scene.drive.frames]
    return {
        "scene_id": scene.scene_id,
        "version_string": "unisim",
        "training_date": "",
        "dataset_hash": digest,
        "uuid": str(uuid.uuid5(uuid.NAMESPACE_OID, digest)),
        "is_resumable": False,
        "sensors": {"camera_ids": list(scene.drive.cameras), "lidar_ids": list(scene.drive.lidars)},
        "logger": {"name": None, "run_id": None, "run_url": None},
        "time_range": {"start": times[0], "end": times[-1]},
        "training_step_outputs": {},
    }


def rig_trajectories(scene: AlpaSimScene, vehicle: VehicleSize) -> dict[str, Any]:
    """Return the rig's recorded trajectory, the cameras' mounts and the times of their images, and the vehicle's box."""
    drive, track = scene.drive, scene.world_from_rig
    times = [microseconds(time_s) for time_s in track.times_s.tolist()]
    keys = [(time_us, pose.tolist()) for time_us, pose in zip(times, track.poses, strict=True) if time_us >= 0]
    images: dict[str, list[list[int]]] = {}
    for name, camera in drive.cameras.items():
        ends = [camera.model_at(time_s).shutter.exposure_s(time_s) for time_s in camera.time_s.values()]
        whole = sorted((microseconds(start), microseconds(end)) for start, end in ends)
        images[f"{name}@{SEQUENCE}"] = [[start, max(end, start + 1)] for start, end in whole if start >= 0]
    return {
        "T_world_base": np.eye(4).tolist(),
        "world_to_nre": {"matrix": np.eye(4).tolist()},
        "camera_calibrations": {
            f"{name}@{SEQUENCE}": {
                "logical_sensor_name": name,
                "unique_sensor_idx": index,
                "T_sensor_rig": scene.rig_from_sensor[name].tolist(),
            }
            for index, name in enumerate(drive.cameras)
        },
        "rig_trajectories": [
            {
                "sequence_id": SEQUENCE,
                "T_rig_world_timestamps_us": [time_us for time_us, _ in keys],
                "T_rig_worlds": [pose for _, pose in keys],
                "cameras_frame_timestamps_us": images,
                "rig_bbox": {
                    "centroid": [vehicle.length_m / 2 - vehicle.rear_overhang_m, 0.0, HEIGHT_M / 2],
                    "dim": [vehicle.length_m, vehicle.width_m, HEIGHT_M],
                    "rot": [0.0, 0.0, 0.0],
                },
            }
        ],
    }


def sequence_tracks(drive: Drive) -> dict[str, Any]:
    """Return the actors' trajectories. AlpaSim moves those that are flagged as controllable: the ones that move here."""
    actors = [actor for _, actor in sorted(drive.actors.items()) if not actor.is_ego_body]
    tracks = [(actor, *_keys(drive, actor)) for actor in actors]
    tracks = [track for track in tracks if len(track[1]) > 1]
    return {
        SEQUENCE: {
            "tracks_data": {
                "tracks_id": [actor.uid for actor, _, _ in tracks],
                "tracks_label_class": [actor.label for actor, _, _ in tracks],
                "tracks_flags": ["CONTROLLABLE" if actor.is_moving else "NONE" for actor, _, _ in tracks],
                "tracks_timestamps_us": [times for _, times, _ in tracks],
                "tracks_poses": [poses for _, _, poses in tracks],
            },
            "cuboidtracks_data": {"cuboids_dims": [actor.size_m.tolist() for actor, _, _ in tracks]},
        }
    }


def _keys(drive: Drive, actor: Actor) -> tuple[list[int], list[list[float]]]:
    """Return the times of an actor's keys, and its poses there: x, y, z and a quaternion x y z w."""
    start, end = drive.window(actor)
    first, last = (drive.time_s[drive.frames[at]] for at in (0, -1))
    start, end = max(start, first, 0.0), min(end, last)
    if start >= end:
        return [], []
    own = actor.world_from_actor.times_s
    times = np.concatenate([[start], own[(own > start) & (own < end)], [end]])
    whole = np.round(times * 1e6).astype(np.int64)
    is_later = np.append(True, np.diff(whole) > 0)
    positions, quaternions = actor.world_from_actor.placed_at(times[is_later])
    poses = np.concatenate([positions, np.roll(quaternions, -1, -1)], -1)
    return whole[is_later].tolist(), poses.tolist()


def ground_mesh(scene: AlpaSimScene, heights: Callable[[FloatArray], FloatArray]) -> bytes:
    """Return the scene's ground beside the recorded path as a PLY mesh of squares."""
    import trimesh

    path = scene.world_from_rig.positions
    low, high = path[:, :2].min(0) - BESIDE_M, path[:, :2].max(0) + BESIDE_M
    counts = np.ceil((high - low) / CELL_M).astype(int) + 1
    x, y = (low[axis] + CELL_M * np.arange(counts[axis]) for axis in (0, 1))
    corners = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    near = _near(corners.reshape(-1, 2), path[:, :2]).reshape(corners.shape[:2])
    z = np.full(corners.shape[:2], np.nan)
    points = np.concatenate([corners[near], np.full((int(near.sum()), 1), float(np.median(path[:, 2])))], -1)
    z[near] = points[:, 2] - heights(points)
    vertices = np.concatenate([corners, z[..., None]], -1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(corners.shape[:2])
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)
    quads = quads[np.isfinite(vertices[quads, 2]).all(1)]
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    mesh = trimesh.Trimesh(np.nan_to_num(vertices), faces, process=False)
    mesh.remove_unreferenced_vertices()
    data: Any = mesh.export(file_type="ply")
    return bytes(data)


def _near(points: FloatArray, path: FloatArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return which points (N, 2) lie within `BESIDE_M` of a path's keys (K, 2)."""
    is_near = np.zeros(len(points), bool)
    for place in path:
        is_near |= np.hypot(*(points - place).T) <= BESIDE_M
    return is_near


def _json(values: Any) -> str:
    return json.dumps(values, indent=1, allow_nan=False) + "\n"
