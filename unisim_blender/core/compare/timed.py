"""How long a renderer takes, told beside what it renders."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..render.drive_renderer import DriveRenderer
from ..sensors.frames import CameraFrame


@dataclass
class Timed:
    """A renderer whose camera frames and sweeps are timed."""

    renderer: DriveRenderer
    seconds: dict[str, list[float]] = field(default_factory=lambda: {"camera": [], "lidar": []})

    def camera(
        self, camera_id: str, frame: int, passes: tuple[str, ...] = ("rgb",), width: int | None = None
    ) -> CameraFrame:
        """See `DriveRenderer.camera`."""
        begun = time.perf_counter()
        image = self.renderer.camera(camera_id, frame, passes, width)
        self.seconds["camera"].append(time.perf_counter() - begun)
        return image

    def rays_lidar(
        self, origins: FloatArray, directions: FloatArray, time_s: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
        """See `DriveRenderer.rays_lidar`."""
        begun = time.perf_counter()
        rays = self.renderer.rays_lidar(origins, directions, time_s)
        self.seconds["lidar"].append(time.perf_counter() - begun)
        return rays

    def medians(self) -> dict[str, float | None]:
        """Median seconds of a camera frame and of a sweep; the first of each, which warms caches, is left out."""
        return {kind: float(np.median(times[1:] or times)) if times else None for kind, times in self.seconds.items()}
