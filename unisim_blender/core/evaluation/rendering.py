"""Interface that evaluation requires of a renderer: images by camera and frame of a log, and LiDAR rays, both timed."""

from __future__ import annotations

import time
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..render.captures import render_image, states_of
from ..render.renderer import Renderer
from ..sensors.frames import CameraFrame
from ..sensors.rays import Rays
from ..world.captures import Capture
from ..world.drive import Drive

RayResults = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]
"""Depth (m), intensity, probability of a return and instance of LiDAR rays, each (N,)."""


class RayRenderer(Protocol):
    """Renderer of camera images and LiDAR rays, as evaluation requires it."""

    def camera(
        self, camera_id: str, frame: int, passes: tuple[str, ...] = ("rgb",), width: int | None = None
    ) -> CameraFrame:
        """Render the image of a frame of the log, ``width`` pixels wide (None: as recorded)."""
        ...

    def rays_lidar(self, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> RayResults:
        """Render LiDAR rays (N, 3), (N, 3), world frame, at times (N,)."""
        ...


class TimedRenderer:
    """A `RayRenderer` of a drive. ``seconds`` are those of each camera frame and each sweep."""

    def __init__(self, renderer: Renderer, drive: Drive) -> None:
        self.renderer, self.states = renderer, states_of(renderer, drive)
        self.seconds: dict[str, list[float]] = {"camera": [], "lidar": []}

    def camera(
        self, camera_id: str, frame: int, passes: tuple[str, ...] = ("rgb",), width: int | None = None
    ) -> CameraFrame:
        """See `RayRenderer.camera`."""
        begun = time.perf_counter()
        capture = Capture.of_frame(self.states.camera(camera_id), frame)
        image = render_image(self.renderer, self.states, capture, passes, width)
        self.seconds["camera"].append(time.perf_counter() - begun)
        return image

    def rays_lidar(self, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> RayResults:
        """See `RayRenderer.rays_lidar`."""
        begun = time.perf_counter()
        times = time_s[np.isfinite(time_s)]
        window = (float(times.min()), float(times.max())) if times.size else (0.0, 0.0)
        results = self.renderer.beams(self.states.states.state(*window), Rays(origins, directions, time_s))
        self.seconds["lidar"].append(time.perf_counter() - begun)
        return results

    def medians(self) -> dict[str, float | None]:
        """Return the median seconds of a camera frame and of a sweep, without the first of each, which fills caches."""
        return {kind: float(np.median(times[1:] or times)) if times else None for kind, times in self.seconds.items()}
