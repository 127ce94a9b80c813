"""A renderer's frames of a drive's log by sensor and number, as what compares them with recordings reads them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..sensors.frames import CameraFrame, LidarFrame, RenderStats
from ..sensors.lidar import lidar_rays
from ..sensors.rays import Rays
from ..world.captures import Capture
from ..world.drive import Camera, Drive, Lidar
from ..world.state import WorldState
from .captures import render_image, render_sweep, states_of
from .regions import Region
from .renderer import Renderer
from .reuse import FrameReuse


class DriveRenderer:
    """Renders frames and captures of a drive with ``renderer``; ``draw`` and ``reuse`` as of `captures.render_capture`."""

    def __init__(
        self, renderer: Renderer, drive: Drive, draw: int | None = None, reuse: FrameReuse | None = None
    ) -> None:
        self.renderer, self.drive, self.draw, self.reuse = renderer, drive, draw, reuse
        self.captures = states_of(renderer, drive)
        self.states = self.captures.states

    def camera(
        self,
        camera_id: str,
        frame: int,
        passes: Sequence[str] = ("rgb",),
        width: int | None = None,
        region: Region | None = None,
    ) -> CameraFrame:
        """Render the image of a frame of the log; see `captures.render_image`."""
        return self.image(Capture.of_frame(self.captures.camera(camera_id), frame), passes, width, region)

    def lidar(self, lidar_id: str, frame: int) -> LidarFrame:
        """Render the sweep of a frame of the log."""
        return self.sweep(Capture.of_frame(self.captures.lidar(lidar_id), frame))

    def image(
        self, capture: Capture, passes: Sequence[str] = ("rgb",), width: int | None = None, region: Region | None = None
    ) -> CameraFrame:
        """See `captures.render_image`."""
        return render_image(self.renderer, self.captures, capture, passes, width, region, self.reuse)

    def sweep(self, capture: Capture) -> LidarFrame:
        """See `captures.render_sweep`."""
        return render_sweep(self.renderer, self.captures, capture, self.draw, self.reuse)

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
        return self.captures.camera(camera_id, width)

    def lidar_named(self, lidar_id: str) -> Lidar:
        """Return a LiDAR of the drive."""
        return self.captures.lidar(lidar_id)

    def sweep_rays(self, capture: Capture) -> tuple[Lidar, Rays]:
        """Return a LiDAR of the drive, and the rays (beams, columns) of its sweep."""
        lidar = self.captures.lidar(capture.sensor_id)
        return lidar, lidar_rays(lidar, capture.time_s(lidar))
