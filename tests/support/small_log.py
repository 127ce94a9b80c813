"""A log of a few frames and beams, written by the writer: what the tests of readers read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.data.log import Sweep
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.geometry import Trajectory, make_pose, quaternion_from_matrix, quaternion_from_yaw
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.world.drive import (
    Actor,
    Appearance,
    Camera,
    CameraModel,
    Drive,
    Lidar,
    LidarModel,
    RollingShutter,
)

FRAMES = 4
CAMERA = CameraModel(48, 32, 40.0, 41.0, 24.5, 15.5, RollingShutter(0.02, 0.25))
LIDAR = LidarModel(np.radians([5.0, 0.0, -5.0, -20.0]), np.radians([1.0, -1.0, 3.0, 0.0]), columns=90)


def small_drive() -> Drive:
    """An ego on a bend, one camera, one LiDAR, a car that turns, a parked van and a cone that comes late."""
    frames = tuple(range(FRAMES))
    time_s = {frame: 0.1 * frame + 0.003 * frame * frame for frame in frames}
    keys = np.array(list(time_s.values()))
    yaw = 0.4 + 0.3 * keys
    origin = np.array([120.0, -45.5, 3.25])
    ego = Trajectory(keys, np.stack([6 * keys, 2 * keys**2, 0.1 * keys], -1), quaternion_from_yaw(yaw))
    mount = make_pose(np.array([0.9, 0.1, 1.8]), quaternion_from_yaw(0.05))
    front = quaternion_from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
    camera_times = {frame: time - 0.04 for frame, time in time_s.items()}
    camera_track = ego.transformed(right=make_pose(np.array([1.5, 0.0, 1.5]), front))
    camera_track = Trajectory(keys - 0.04, camera_track.positions, camera_track.quaternions_wxyz)
    car_track = Trajectory(
        keys, np.stack([15 + 5 * keys, keys, 0 * keys + 0.8], -1), quaternion_from_yaw(3.0 + 0.5 * keys)
    )
    still = Trajectory(np.zeros(1), np.array([[8.0, -4.0, 0.9]]), quaternion_from_yaw(np.array([-1.1])))
    actors = {
        "car-1": Actor(
            "car-1", "Car", np.array([4.5, 1.9, 1.6]), car_track, -0.05, keys[-1] + 0.05, True, Appearance("car-1")
        ),
        "cone": Actor(
            "cone", "Cones", np.array([0.4, 0.5, 0.7]), still, keys[2] - 0.05, keys[3] + 0.05, False, Appearance("cone")
        ),
        "van": Actor("van", "Car", np.array([5.5, 2.1, 2.2]), still, -0.05, keys[-1] + 0.05, False, Appearance("van")),
    }
    return Drive(
        name="bend",
        frames=frames,
        time_s=time_s,
        world_from_ego=ego,
        cameras={"front_camera": Camera("front_camera", CAMERA, camera_track, camera_times)},
        lidars={"pandar64": Lidar("pandar64", LIDAR, ego.transformed(right=mount), time_s)},
        actors=actors,
        world_origin=origin,
    )


def small_image(frame: int) -> NDArray[np.uint8]:
    """A smooth image, each frame's its own."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return np.asarray(np.stack([u * 5, v * 7, np.full_like(u, 40 * frame)], -1), np.uint8)


def small_sweep(drive: Drive, frame: int) -> Sweep:
    """Returns of all beams but for every seventh column, at depths that grow with the column."""
    lidar = drive.lidars["pandar64"]
    rays = lidar_rays(lidar, lidar.time_s[frame])
    ring, column = np.nonzero(np.broadcast_to(np.arange(LIDAR.columns) % 7 != 0, (LIDAR.beams, LIDAR.columns)))
    depth = 5.0 + 0.1 * column + ring
    origins, directions = rays.origins[ring, column], rays.directions[ring, column]
    return Sweep(
        points=origins + depth[:, None] * directions,
        origins=origins,
        time_s=rays.time_s[ring, column],
        intensity=(column / LIDAR.columns).astype(np.float32),
        ring=ring.astype(np.int32),
        column=column.astype(np.int32),
        semantic=(ring + 5).astype(np.int32),
    )


def write_small_log(path: Path, drive: Drive | None = None) -> Drive:
    """The whole log at ``path``; gives the drive that went in."""
    drive = drive or small_drive()
    writer = PandasetWriter(path, drive)
    for frame in drive.frames:
        writer.write_image("front_camera", frame, small_image(frame))
        writer.write_sweep(frame, {"pandar64": small_sweep(drive, frame)})
        writer.write_cuboids(frame)
    writer.finish()
    return drive
