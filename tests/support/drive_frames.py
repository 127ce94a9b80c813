"""A renderer's frames of a drive by sensor and number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.render.captures import render_image, render_sweep, states_of
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.reuse import FrameReuse
from unisim_blender.core.sensors.frames import CameraFrame, LidarFrame, RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import Camera, Drive, Lidar
from unisim_blender.core.world.replay import WorldState


class DriveFrames:
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
