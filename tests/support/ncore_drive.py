"""A small log with what NCore has places for: every lens and shutter, several LiDARs, drops, several returns, masks, a roll."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from small_log import small_drive

from unisim_blender.core.data.log import Drops, Sweep, SweepGrid
from unisim_blender.core.data.sweep_cells import make_grid
from unisim_blender.core.geometry import Trajectory, make_pose, quaternion_from_matrix, quaternion_from_yaw
from unisim_blender.core.lenses import PINHOLE
from unisim_blender.core.lenses.f_theta import FTheta
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.world.drive import (
    Actor,
    Appearance,
    Camera,
    CameraModel,
    Drive,
    Lidar,
    LidarModel,
    Readouts,
    RollingShutter,
    SpinPhase,
)

WIDTH, HEIGHT = 48, 32
LENSES: dict[str, tuple[Lens, RollingShutter]] = {
    "ideal": (PINHOLE, RollingShutter(0.02, 0.25)),
    "distorted": (
        OpenCVPinhole(-0.2, 0.05, 0.001, -0.002, 0.01, 0.02, -0.01, 0.003, 1e-3, -2e-3, 1e-3, 5e-4),
        RollingShutter(-0.015, 0.5),
    ),
    "fisheye": (OpenCVFisheye(0.05, -0.01, 0.002, -0.001, 100.0), RollingShutter(0.0133337, 1.0, "columns")),
    "forward": (
        FTheta((1.0, 0.01, -0.05, 0.004), (), 95.0, (1.01, 0.002, -0.003)),
        RollingShutter(-0.03, 0.0, "columns"),
    ),
    "backward": (FTheta((), (1.0, -0.02, 0.06), 80.0), RollingShutter()),
}
SPINNING = LidarModel(
    np.radians([5.0, 0.0, -5.0, -20.0]),
    np.radians([1.0, -1.0, 3.0, 0.0]),
    columns=90,
    time_offset_s=0.0001,
    start_azimuth_rad=2.7,
    min_range_m=0.3,
    max_range_m=123.0,
    beam_time_s=np.array([0.0, 1e-5, 2e-5, 3.3e-5]),
)
UNEVEN = LidarModel(
    np.radians([2.0, -3.0]),
    np.zeros(2),
    columns=40,
    direction=1,
    column_azimuth_rad=-1.0 + 2.0 * np.linspace(0, 1, 40) ** 1.2,
    column_time_s=-0.1 + 0.09 * np.linspace(0, 1, 40) ** 1.1,
)
PLAIN = LidarModel(np.zeros(0), np.zeros(0), columns=1, max_range_m=300.0)


def ncore_drive(lenses: Mapping[str, tuple[Lens, RollingShutter]] = LENSES) -> Drive:
    """The small drive with more sensors; one camera has a rate and a trajectory of its own, times are no whole microseconds."""
    small = small_drive()
    ego = small.world_from_ego
    front = quaternion_from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
    cameras = {}
    for number, (name, (lens, shutter)) in enumerate(lenses.items()):
        model = CameraModel(WIDTH, HEIGHT, 30.3, 31.7, 24.25, 15.75, shutter, lens)
        track = ego.transformed(right=make_pose(np.array([1.5, 0.2 * number, 1.5]), front))
        times = {frame: time - 0.0123456789 - 0.001 * number for frame, time in small.time_s.items()}
        cameras[name] = Camera(name, model, track, times)
    if "ideal" in cameras:  # rides loosely, and has images between the frames
        own = small.cameras["front_camera"].world_from_camera
        times = dict(enumerate(cameras["ideal"].time_s.values())) | {4: 0.05, 5: 0.1512345}
        cameras["ideal"] = replace(cameras["ideal"], world_from_camera=own, time_s=times)
    if "fisheye" in cameras:  # its exposures differ
        stamps = np.array(list(cameras["fisheye"].time_s.values()))
        cameras["fisheye"] = replace(cameras["fisheye"], readouts=Readouts(stamps, np.array([1.0, 0.7, 1.3, 1.0])))
    lidars = {}
    for number, (name, table) in enumerate({"roof": SPINNING, "side": UNEVEN, "long": PLAIN}.items()):
        mount = make_pose(np.array([0.9, 0.1 * number, 1.8]), quaternion_from_yaw(0.05 + number))
        lidars[name] = Lidar(name, table, ego.transformed(right=mount), dict(small.time_s))
    keys = np.array(list(small.time_s.values()))
    lidars["roof"] = replace(lidars["roof"], phase=SpinPhase(keys, np.array([0.0, 0.01, 0.03, 0.04])))
    tilted = np.array([0.9, 0.1, -0.2, 0.3])
    turning = np.stack([tilted, tilted + (0, 0.1, 0, 0), tilted + (0, 0.1, 0.3, 0)])
    turning /= np.linalg.norm(turning, axis=1, keepdims=True)
    seen = np.array([0.02000031, 0.15, 0.4])
    track = Trajectory(seen, np.array([[5.0, 1, 0], [6.0, 1, 0.2], [8.0, 0, 0.1]]), turning)
    size = np.array([1.0, 0.5, 1.7])
    rider = Actor("rider/1", "Bike, with rider", size, track, 0.01, np.inf, True, Appearance("rider/1"))
    return replace(small, name="all of it", cameras=cameras, lidars=lidars, actors={**small.actors, rider.uid: rider})


class MadeLog:
    """A log in memory over a drive: images, sweeps with drops and several returns, masks, all of them made by number."""

    def __init__(self, drive: Drive | None = None) -> None:
        self.path = Path("made")
        self.drive = drive or ncore_drive()
        self.missing: tuple[str, ...] = ()
        self.classes = {"Bike, with rider": "deforming"}

    def image_frames(self, camera: str) -> tuple[int, ...]:
        return tuple(self.drive.cameras[camera].time_s)

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        return tuple(frame for frame in self.drive.lidars[lidar].time_s if (lidar, frame) != ("side", 2))

    def image_path(self, camera: str, frame: int) -> Path | None:
        return None

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        v, u = np.mgrid[:HEIGHT, :WIDTH]
        return np.asarray(np.stack([u * 5, v * 7, np.full_like(u, 30 * frame)], -1), np.uint8)

    def own_vehicle_mask(self, camera: str) -> NDArray[np.bool_] | None:
        if camera != "fisheye":
            return None
        mask = np.zeros((HEIGHT, WIDTH), bool)
        mask[25:, 10:30] = True
        return mask

    def sweep(self, lidar: str, frame: int) -> Sweep:
        sensor = self.drive.lidars[lidar]
        source = replace(sensor, model=sensor.model if sensor.model.beams else SPINNING)
        rays = lidar_rays(source, source.time_s[frame])
        beams, columns = rays.time_s.shape
        ring, column = (x.ravel() for x in np.mgrid[:beams, :columns])
        hit, lost = (column + ring) % 7 != 0, (column + ring) % 7 == 0
        if sensor.model.beams:
            lost &= column % 2 == 0  # of the others nothing is known
        twice = hit & (column % 3 == 0)
        number = np.concatenate([np.flatnonzero(hit), np.flatnonzero(twice)])
        rank = np.concatenate([np.zeros(hit.sum(), np.int32), np.ones(twice.sum(), np.int32)])
        depth = 5.0 + 0.1 * column[number] + ring[number] + 7.5 * rank
        origins, directions = rays.origins.reshape(-1, 3), rays.directions.reshape(-1, 3)
        times = rays.time_s.ravel()
        ring, column = (np.where(sensor.model.beams, x, -1).astype(np.int32) for x in (ring, column))
        if lidar == "roof":  # one return that no beam fits
            ring[number[5]] = column[number[5]] = -1
            rank, depth, number = (
                np.delete(x, np.flatnonzero((number == number[5]) & (rank == 1))) for x in (rank, depth, number)
            )
        return Sweep(
            points=origins[number] + depth[:, None] * directions[number],
            origins=origins[number],
            time_s=times[number],
            intensity=((1.0 - 0.4 * rank) * (column[number] % 90 / 100 + 0.05)).astype(np.float32),
            ring=ring[number],
            column=column[number],
            semantic=np.where(rank == 0, 3, 4).astype(np.int32),
            rank=rank,
            drops=Drops(origins[lost], directions[lost], times[lost], ring[lost], column[lost]),
        )

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        sensor = self.drive.lidars[lidar]
        nothing = np.zeros((sensor.model.beams, sensor.model.columns), bool)
        return make_grid(self.sweep(lidar, frame), sensor, frame, nothing)
