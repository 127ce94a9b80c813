"""A drive of a few frames and a renderer that needs no training, for tests of all that happens around rendering."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.drive import Actor, Camera, CameraModel, Drive, Lidar, LidarModel, Look
from unisim_blender.core.frames import CameraFrame, LidarFrame, RenderStats
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_matrix
from unisim_blender.core.render_plan import RenderPlan, SequenceSettings
from unisim_blender.core.sensors.lidar import lidar_rays

IDENTITY = np.array([1.0, 0, 0, 0])
FRONT = quaternion_from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
"""A camera's axes when it looks along the world's x."""


def tiny_drive(frames: int = 6) -> Drive:
    """An ego that drives along x at 5 m/s behind a car at 4 m/s, past a cone that stands; one camera, one LiDAR of 4 beams."""
    times = {frame: 0.1 * frame for frame in range(frames)}
    keys = np.array(list(times.values()))

    def along_x(start: FloatArray, speed: float, quaternion: FloatArray) -> Trajectory:
        positions = start + keys[:, None] * np.array([speed, 0, 0])
        return Trajectory(keys, positions, np.broadcast_to(quaternion, (frames, 4)))

    camera = Camera("front", CameraModel(32, 18, 30.0, 30.0, 16.0, 9.0), along_x(np.array([1.0, 0, 1.6]), 5.0, FRONT), times)
    model = LidarModel(np.deg2rad([2.0, 0.0, -5.0, -15.0]), np.zeros(4), columns=36)
    lidar = Lidar("top", model, along_x(np.array([0.0, 0, 1.8]), 5.0, IDENTITY), times)
    car = Actor(
        "car",
        "Car",
        np.array([4.5, 1.9, 1.5]),
        along_x(np.array([12.0, 0.5, 0.75]), 4.0, IDENTITY),
        0.0,
        keys[-1],
        True,
        Look("car"),
    )
    cone = Actor(
        "cone",
        "Cones",
        np.array([0.4, 0.4, 0.8]),
        Trajectory(np.zeros(1), np.array([[8.0, -2.0, 0.4]]), IDENTITY[None]),
        0.0,
        0.2,
        False,
        Look("cone"),
    )
    ego = along_x(np.zeros(3), 5.0, IDENTITY)
    return Drive("tiny", tuple(times), times, ego, {"front": camera}, {"top": lidar}, {"car": car, "cone": cone})


@dataclass(frozen=True)
class FakeRenderer:
    """Pictures and sweeps that follow from sensor and frame alone; counts its frames in ``log_path``, if given."""

    drive: Drive
    log_path: Path | None = None
    delay_s: float = 0.0

    def camera(self, camera_id: str, frame: int, passes: tuple[str, ...] = ("rgb",), width: int | None = None) -> CameraFrame:
        """A picture of noise, with every pass asked for."""
        time.sleep(self.delay_s)
        if self.log_path is not None:
            with open(self.log_path, "a") as file:
                file.write(f"{frame} {os.getpid()}\n")
        camera = self.drive.cameras[camera_id]
        model = camera.model.resized(width or camera.model.width)
        rng = np.random.default_rng(frame)
        shape = (model.height, model.width)
        depth = rng.uniform(1, 50, shape).astype(np.float32)
        depth[0] = np.inf

        def asked(name: str, value: NDArray[Any]) -> NDArray[Any] | None:
            return value if name in passes else None

        return CameraFrame(
            model,
            camera.world_from_camera.at(camera.time_s[frame]),
            rng.random((*shape, 3), dtype=np.float32),
            asked("depth", depth),
            asked("depth", depth * np.float32(0.9)),
            asked("normal", np.broadcast_to(np.array([0, 0, 1], np.float32), (*shape, 3))),
            asked("instance", rng.integers(0, 3, shape, dtype=np.int32)),
            asked("opacity", rng.random(shape, dtype=np.float32)),
            asked("support", rng.random(shape) < 0.1),
            ("car", "cone"),
            RenderStats(rays=depth.size, samples_spent=10 + frame, samples_saved=5, seconds={"march": time.monotonic()}),
        )

    def lidar(self, lidar_id: str, frame: int) -> LidarFrame:
        """A sweep of the table's rays with depths of noise; one cell in four is a drop."""
        lidar = self.drive.lidars[lidar_id]
        rays = lidar_rays(lidar, frame)
        rng = np.random.default_rng(frame)
        shape = rays.time_s.shape
        return LidarFrame(
            lidar.model,
            lidar.world_from_lidar.at(lidar.time_s[frame]),
            rays.origins,
            rays.directions,
            rays.time_s,
            rng.uniform(2, 60, shape).astype(np.float32),
            rng.random(shape, dtype=np.float32),
            rng.random(shape, dtype=np.float32),
            rng.random(shape) < 0.75,
            rng.integers(0, 3, shape, dtype=np.int32),
            ("car", "cone"),
            RenderStats(rays=rays.time_s.size, samples_spent=7, samples_saved=3),
        )


@dataclass(frozen=True)
class FakeSource:
    """Makes a `FakeRenderer` in whatever process asks."""

    drive: Drive
    log_path: Path | None = None
    delay_s: float = 0.0

    def __call__(self) -> FakeRenderer:
        """The renderer."""
        return FakeRenderer(self.drive, self.log_path, self.delay_s)


ALL_PASSES = ("rgb", "depth", "normal", "instance", "opacity", "support")


def tiny_plan(log_path: Path | None = None, delay_s: float = 0.0, frames: int = 6, width: int | None = None) -> RenderPlan:
    """All frames of the tiny drive with all passes."""
    drive = tiny_drive(6)
    settings = SequenceSettings(("front",), ("top",), ALL_PASSES, width)
    about = {"scenario": {"sha256": "0" * 64}}
    return RenderPlan(drive, drive.frames[:frames], settings, FakeSource(drive, log_path, delay_s), {"": "1" * 64}, about)


def world_pose(x: float, y: float, z: float) -> FloatArray:
    """A pose (4, 4) without rotation."""
    return make_pose(np.array([x, y, z]), IDENTITY)
