"""Render captures of a drive, with sensors and states of the world taken from the drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import FloatArray
from ..sensors.frames import CameraFrame, LidarFrame, RenderStats
from ..sensors.lidar import lidar_rays
from ..sensors.rays import Rays
from ..world.captures import Capture
from ..world.drive import Camera, Drive, Lidar
from ..world.replay import DriveStates
from ..world.state import WorldState
from .captures import CaptureStates
from .kept.frames import KeptFrames
from .regions import Region
from .renderer import Renderer


class DriveRenderer:
    """Renders captures of a drive with ``renderer``. ``draw`` and the capture seed the random draw of which beams
    return (`Capture.seed`). With None, beams return whose probability is 0.5 or more. ``kept`` are the sensors' last
    frames: while a sensor stands, only what may differ from its last frame is rendered."""

    def __init__(
        self, renderer: Renderer, drive: Drive, draw: int | None = None, kept: KeptFrames | None = None
    ) -> None:
        self.renderer, self.drive, self.draw, self.kept = renderer, drive, draw, kept
        self.states = DriveStates(drive, renderer.backend.parked)
        self.captures = CaptureStates(self.states, renderer.reach, renderer.backend.sees_all)

    def camera(
        self,
        camera_id: str,
        frame: int,
        passes: Sequence[str] = ("rgb",),
        width: int | None = None,
        region: Region | None = None,
    ) -> CameraFrame:
        """Render the image of a frame of the log; see `image`."""
        return self.image(Capture.of_frame(self.sized(camera_id, None), frame), passes, width, region)

    def lidar(self, lidar_id: str, frame: int) -> LidarFrame:
        """Render the sweep of a frame of the log."""
        return self.sweep(Capture.of_frame(self.lidar_named(lidar_id), frame))

    def image(
        self, capture: Capture, passes: Sequence[str] = ("rgb",), width: int | None = None, region: Region | None = None
    ) -> CameraFrame:
        """Render one image with these passes, or only its ``region``: the frame's arrays then have
        the region's size."""
        camera = self.sized(capture.sensor_id, width)
        time_s = capture.time_s(camera)
        state = self.state(camera, time_s)
        if self.kept is not None and region is None:
            return self.kept.image(self.renderer, state, camera, time_s, passes)
        return self.renderer.render(state, camera, time_s, passes, region)

    def sweep(self, capture: Capture) -> LidarFrame:
        """Render one sweep."""
        lidar = self.lidar_named(capture.sensor_id)
        time_s = capture.time_s(lidar)
        seed = None if self.draw is None else capture.seed(self.draw)
        state = self.state(lidar, time_s)
        if self.kept is not None:
            return self.kept.sweep(self.renderer, state, lidar, time_s, seed)
        return self.renderer.render(state, lidar, time_s, seed=seed)

    def rays_lidar(
        self,
        origins: FloatArray,
        directions: FloatArray,
        time_s: FloatArray,
        stats: RenderStats | None = None,
        lidar: Lidar | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
        """Render arbitrary LiDAR rays (N,), world frame, at times (N,); see `Renderer.beams` for what is returned."""
        times = time_s[np.isfinite(time_s)]
        window = (float(times.min()), float(times.max())) if times.size else (0.0, 0.0)
        return self.renderer.beams(self.states.state(*window), Rays(origins, directions, time_s), lidar, stats)

    def state(self, sensor: Camera | Lidar, time_s: float) -> WorldState:
        """Return the state of the world that a sensor's frame at ``time_s`` depends on."""
        return self.captures.state(sensor, time_s)

    def sized(self, camera_id: str, width: int | None) -> Camera:
        """Return a camera of the drive, its images ``width`` pixels wide."""
        camera: Camera = _pick(self.drive.cameras, camera_id, "camera")
        return camera.resized(width) if width else camera

    def lidar_named(self, lidar_id: str) -> Lidar:
        """Return a LiDAR of the drive."""
        return _pick(self.drive.lidars, lidar_id, "LiDAR")

    def sweep_rays(self, capture: Capture) -> tuple[Lidar, Rays]:
        """Return a LiDAR of the drive, and the rays (beams, columns) of its sweep."""
        lidar = self.lidar_named(capture.sensor_id)
        return lidar, lidar_rays(lidar, capture.time_s(lidar))


Sensor = TypeVar("Sensor", Camera, Lidar)


def _pick(sensors: dict[str, Sensor], sensor_id: str, kind: str) -> Sensor:
    if sensor_id not in sensors:
        raise SceneError(f"no {kind} {sensor_id!r} in the drive: there are {', '.join(sensors) or 'none'}")
    return sensors[sensor_id]
