"""Results of rendering one sensor and frame: the neural renderer and the street's exact one give the same."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray
from ..world.drive import CameraModel, LidarModel
from .error_bound import ErrorBoundResult

CAMERA_PASSES = ("rgb", "depth", "normal", "instance", "opacity", "unsupported", "confidence")
"""Passes a camera frame can hold; ``rgb`` alone is rendered where nothing else was asked for."""
FILLS = ("none", "texture")
"""What is shown where nobody saw, besides fixers: what the scene has there, or on ground the texture of the street."""
FORMER_PASSES = {"support": "unsupported"}
"""Former names of passes, which scenario files and the command line may still have."""


@dataclass
class RenderStats:
    """Counts of work: rays, field samples spent, samples saved relative to a uniform march through the volume, and
    actors culled; and seconds by step."""

    rays: int = 0
    samples_spent: int = 0
    samples_saved: int = 0
    actors_skipped: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    def add(self, other: RenderStats) -> None:
        """Add another part's counts to these."""
        self.rays += other.rays
        self.samples_spent += other.samples_spent
        self.samples_saved += other.samples_saved
        self.actors_skipped += other.actors_skipped
        for name, value in other.seconds.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + value


EMPTY_PIXEL = {
    "rgb": 0.0, "depth_m": np.inf, "z_depth_m": np.inf, "normal": 0.0, "instance": 0.0, "opacity": 0.0,
    "unsupported": True, "confidence": 0.0,
}  # fmt: skip
"""The arrays of a `CameraFrame`, with their values where a pixel shows nothing."""


@dataclass
class CameraFrame:
    """One image. Passes that were not asked for are None.

    rgb (H, W, 3) display-referred sRGB in 0..1; depth_m (H, W) along the ray, z_depth_m (H, W) along the optical axis,
    both inf where nothing was hit; normal (H, W, 3) unit, world frame, 0 where nothing was hit; instance (H, W) index
    into ``instances`` plus 1, 0 for the background; opacity (H, W) in 0..1; unsupported (H, W) True where no recorded
    ray supports the pixel; confidence (H, W) in 0..1, the probability that the pixel is right (`render.confidence`).
    Where the lens has no direction for a pixel (`sensors.unprojection.image_mask`) it is black, unsupported and of
    confidence 0, and nothing is hit.
    """

    model: CameraModel
    world_from_camera: FloatArray
    rgb: NDArray[np.float32]
    depth_m: NDArray[np.float32] | None = None
    z_depth_m: NDArray[np.float32] | None = None
    normal: NDArray[np.float32] | None = None
    instance: NDArray[np.int32] | None = None
    opacity: NDArray[np.float32] | None = None
    unsupported: NDArray[np.bool_] | None = None
    instances: tuple[str, ...] = ()
    stats: RenderStats = field(default_factory=RenderStats)
    error_bound: ErrorBoundResult | None = None
    confidence: NDArray[np.float32] | None = None

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the colours and the passes that were asked for, by their names."""
        return {name: array for name in EMPTY_PIXEL if (array := getattr(self, name)) is not None}

    def cropped(self, left: int, top: int, right: int, bottom: int) -> CameraFrame:
        """Return the frame of these columns and rows, first and past the last."""
        part = replace(self)
        for name, array in self.arrays().items():
            setattr(part, name, array[top:bottom, left:right])
        return part

    def blank(self, shown: BoolArray) -> None:
        """Make the frame black and empty where ``shown`` (H, W) is False; colours in place of the array that is
        there."""
        for name, array in self.arrays().items():
            there = shown[..., None] if array.ndim == 3 else shown
            setattr(self, name, np.where(there, array, array.dtype.type(EMPTY_PIXEL[name])))


@dataclass
class LidarFrame:
    """One sweep as beams x columns. World frame; ``world_from_lidar`` is the sensor's pose at the frame's time.

    origins, directions (B, C, 3) float64; time_s (B, C) float64; depth_m, intensity (0..1), return_probability (B, C)
    float32; returned (B, C) bool; instance (B, C) index into ``instances`` plus 1, 0 for the background.
    """

    model: LidarModel
    world_from_lidar: FloatArray
    origins: FloatArray
    directions: FloatArray
    time_s: FloatArray
    depth_m: NDArray[np.float32]
    intensity: NDArray[np.float32]
    return_probability: NDArray[np.float32]
    returned: NDArray[np.bool_]
    instance: NDArray[np.int32]
    instances: tuple[str, ...] = ()
    stats: RenderStats = field(default_factory=RenderStats)
    error_bound: ErrorBoundResult | None = None
