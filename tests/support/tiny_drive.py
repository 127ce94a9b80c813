"""A drive of a few frames and a renderer that needs no training, for tests of all that happens around rendering."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.data.log import Sweep, SweepGrid
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_matrix
from unisim_blender.core.render.captures import CaptureStates
from unisim_blender.core.render.code_identity import code_identity
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.visibility import Reach
from unisim_blender.core.scenes.recipe import RendererRecipe, RenderMethod, environment
from unisim_blender.core.sensors.frames import CameraFrame, LidarFrame, RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sequence.plan import RenderPlan, SequenceSettings
from unisim_blender.core.world.captures import moments_of
from unisim_blender.core.world.drive import Actor, Appearance, Camera, CameraModel, Drive, Lidar, LidarModel
from unisim_blender.core.world.replay import DriveStates, WorldState

IDENTITY = np.array([1.0, 0, 0, 0])
FRONT = quaternion_from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
"""A camera's axes when it looks along the world's x."""


def tiny_drive(frames: int = 6) -> Drive:
    """An ego that drives along x at 5 m/s behind a car at 4 m/s, past a cone that stands; one camera, one
    LiDAR of 4 beams."""
    times = {frame: 0.1 * frame for frame in range(frames)}
    keys = np.array(list(times.values()))

    def along_x(start: FloatArray, speed: float, quaternion: FloatArray) -> Trajectory:
        positions = start + keys[:, None] * np.array([speed, 0, 0])
        return Trajectory(keys, positions, np.broadcast_to(quaternion, (frames, 4)))

    camera = Camera(
        "front", CameraModel(32, 18, 30.0, 30.0, 16.0, 9.0), along_x(np.array([1.0, 0, 1.6]), 5.0, FRONT), times
    )
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
        Appearance("car"),
    )
    cone = Actor(
        "cone",
        "Cones",
        np.array([0.4, 0.4, 0.8]),
        Trajectory(np.zeros(1), np.array([[8.0, -2.0, 0.4]]), IDENTITY[None]),
        0.0,
        0.2,
        False,
        Appearance("cone"),
    )
    ego = along_x(np.zeros(3), 5.0, IDENTITY)
    return Drive("tiny", tuple(times), times, ego, {"front": camera}, {"top": lidar}, {"car": car, "cone": cone})


@dataclass(frozen=True)
class FakeRenderer:
    """Images and sweeps that follow from sensor and frame alone; counts its frames in ``log_path``, if given."""

    drive: Drive
    log_path: Path | None = None
    delay_s: float = 0.0

    def camera(
        self, camera_id: str, frame: int, passes: tuple[str, ...] = ("rgb",), width: int | None = None
    ) -> CameraFrame:
        """An image of noise, with every pass asked for."""
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
            asked("unsupported", rng.random(shape) < 0.1),
            ("car", "cone"),
            RenderStats(
                rays=depth.size, samples_spent=10 + frame, samples_saved=5, seconds={"march": time.monotonic()}
            ),
        )

    def start(self, *asked: Any, **values: Any) -> Callable[[], CameraFrame | LidarFrame]:
        """See `Renderer.start`."""
        return partial(self.render, *asked, **values)

    def render(
        self,
        state: WorldState,
        sensor: Camera | Lidar,
        time_s: float,
        passes: tuple[str, ...] = ("rgb",),
        region: None = None,
        seed: tuple[int, ...] | None = None,
    ) -> CameraFrame | LidarFrame:
        """What `Renderer.render` is asked for, of the frame at a time or before it."""
        frame = next((frame for frame, own_s in sensor.time_s.items() if own_s == time_s), None)
        if frame is None:
            frame = max((frame for frame, own_s in self.drive.time_s.items() if own_s <= time_s + 1e-6), default=0)
        if isinstance(sensor, Camera):
            return self.camera(sensor.sensor_id, frame, passes, sensor.model.width)
        return self.lidar(sensor.sensor_id, frame)

    def lidar(self, lidar_id: str, frame: int) -> LidarFrame:
        """A sweep of the table's rays with depths of noise; one cell in four is a drop."""
        lidar = self.drive.lidars[lidar_id]
        rays = lidar_rays(lidar, lidar.time_s[frame])
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
class FakeMethod(RenderMethod):
    """Loads a `FakeRenderer` in whatever process asks."""

    drive: Drive
    log_path: Path | None = None
    delay_s: float = 0.0

    def load(self, recipe: RendererRecipe) -> Renderer:
        return cast(Renderer, FakeRenderer(self.drive, self.log_path, self.delay_s))

    def digests(self, recipe: RendererRecipe, drive: Drive) -> dict[str, str]:
        return {"": "1" * 64}

    def states(self, recipe: RendererRecipe, drive: Drive) -> CaptureStates:
        return CaptureStates(DriveStates(drive, {}), Reach())


def recipe_of(method: FakeMethod) -> RendererRecipe:
    """The recipe of a fake renderer, planned on this machine."""
    here = code_identity()["sha256"], environment("cpu")
    origin = method.drive.world_origin
    return RendererRecipe(method, Path("log"), None, {}, origin, "balanced", "cpu", False, None, *here)


ALL_PASSES = ("rgb", "depth", "normal", "instance", "opacity", "unsupported")


def tiny_plan(
    log_path: Path | None = None, delay_s: float = 0.0, frames: int = 6, width: int | None = None
) -> RenderPlan:
    """All frames of the tiny drive with all passes."""
    drive = tiny_drive(6)
    settings = SequenceSettings(("front",), ("top",), ALL_PASSES, width=width)
    about = {"scenario": {"sha256": "0" * 64}}
    recipe = recipe_of(FakeMethod(drive, log_path, delay_s))
    captures = CaptureStates(DriveStates(drive, {}), Reach())
    moments = moments_of(drive, drive.frames[:frames], None, ("front",), ("top",))
    return RenderPlan(drive, moments, settings, recipe, {"": "1" * 64}, {"numpy": np.__version__}, about, captures)


def world_pose(x: float, y: float, z: float) -> FloatArray:
    """A pose (4, 4) without rotation."""
    return make_pose(np.array([x, y, z]), IDENTITY)


class TinyLog:
    """A log whose images and sweeps are the fake renderer's, the images darker by ``offset``, the depths
    longer by 0.1 m."""

    def __init__(self, offset: float = 0.1) -> None:
        self.drive = tiny_drive()
        self.path = Path("tiny")
        self.missing: tuple[str, ...] = ()
        self.offset = offset
        self.renderer = FakeRenderer(self.drive)

    def image_frames(self, camera: str) -> tuple[int, ...]:
        return self.drive.frames

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        return self.drive.frames[:-1]

    def image_path(self, camera: str, frame: int) -> Path | None:
        return None

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        rgb = np.full((18, 32, 3), 0.5 - self.offset + 0.01 * frame**2)
        image: NDArray[np.uint8] = np.rint(rgb * 255).astype(np.uint8)
        return image

    def sweep(self, lidar: str, frame: int) -> Sweep:
        raise AssertionError("evaluation uses the grid")

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        sweep = self.renderer.lidar(lidar, frame)
        blocked = np.zeros(sweep.returned.shape, bool)
        blocked[:, :6] = True
        returned = sweep.returned & ~blocked
        return SweepGrid(
            sweep.model,
            sweep.origins,
            sweep.directions,
            sweep.time_s,
            np.where(returned, sweep.depth_m + np.float32(0.1), 0).astype(np.float32),
            np.where(returned, 0.5, 0).astype(np.float32),
            returned,
            blocked,
        )


def log_with_captures_between(offset: float = 0.1) -> TinyLog:
    """Between its frames, ten a second, lie images at 0.34 s (frame 3's second one) and 0.36 s (frame 4's), and a sweep at
    0.26 s."""
    log = TinyLog(offset)
    camera, lidar = log.drive.cameras["front"], log.drive.lidars["top"]
    cameras = {"front": replace(camera, time_s={**camera.time_s, 6: 0.34, 7: 0.36})}
    log.drive = replace(log.drive, cameras=cameras, lidars={"top": replace(lidar, time_s={**lidar.time_s, 6: 0.26})})
    log.renderer = replace(log.renderer, drive=log.drive)
    log.image_frames = lambda camera: tuple(range(8))  # type: ignore[method-assign]
    log.sweep_frames = lambda lidar: (*range(5), 6)  # type: ignore[method-assign]
    return log


class GreyRenderer(FakeRenderer):
    """Images that are grey all over, and LiDAR rays that all return, at the fake sweep's depth."""

    def camera(
        self, camera_id: str, frame: int, passes: tuple[str, ...] = ("rgb",), width: int | None = None
    ) -> CameraFrame:
        image = super().camera(camera_id, frame, passes, width)
        image.rgb[:] = 0.5
        return image

    def rays_lidar(
        self, origins: FloatArray, directions: FloatArray, time_s: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
        """Looks the depths up by time and direction."""
        frame = next(f for f, t in self.drive.time_s.items() if t - 0.1 <= time_s.min() and time_s.max() <= t)
        sweep = self.lidar("top", frame)
        cells = {key.tobytes(): i for i, key in enumerate(sweep.directions.reshape(-1, 3))}
        depth = sweep.depth_m.reshape(-1)[[cells[d.tobytes()] for d in directions]]
        one = np.ones(len(depth), np.float32)
        return depth, one * np.float32(0.25), one, np.zeros(len(depth), np.int32)
