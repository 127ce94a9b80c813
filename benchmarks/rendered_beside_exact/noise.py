"""Sensors whose ranges have noise: how differently the same loop goes on other noise is its own sensitivity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.simulation.clock import Exposure
from unisim_blender.core.simulation.drivers.driver import CameraImage, LidarSweep
from unisim_blender.core.simulation.rollout.sensors import SensorSource
from unisim_blender.core.world.drive import Drive


@dataclass
class NoisySensors:
    """Delivers what ``sensors`` do, with normal noise of ``deviation_m`` on the ranges of sweeps. ``seed`` and a sweep's time
    decide it: it does not depend on what was delivered before."""

    sensors: SensorSource
    deviation_m: float
    seed: tuple[int, ...]
    unsupported: dict[str, float] = field(default_factory=dict)
    confidence: dict[str, float] = field(default_factory=dict)

    def render(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """See `SensorSource.render`."""
        return self._with_noise(*self.sensors.render(drive, exposures))

    def read(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """See `SensorSource.read`."""
        return self._with_noise(*self.sensors.read(drive, exposures))

    def _with_noise(
        self, images: list[CameraImage], sweeps: list[LidarSweep]
    ) -> tuple[list[CameraImage], list[LidarSweep]]:
        self.unsupported, self.confidence = self.sensors.unsupported, self.sensors.confidence
        return images, [
            replace(one, points=noisy(one.points, self.deviation_m, (*self.seed, one.time_us))) for one in sweeps
        ]


def noisy(points: NDArray[np.void], deviation_m: float, seed: Sequence[int]) -> NDArray[np.void]:
    """Return a sweep's points, each moved along its ray from the LiDAR."""
    found = points.copy()
    places = np.stack([points[axis] for axis in "xyz"], -1).astype(np.float64)
    ranges = np.sqrt((places * places).sum(-1))
    noise = np.random.default_rng([*seed]).normal(0.0, deviation_m, len(points))
    places *= (1 + noise / np.maximum(ranges, 1e-3))[:, None]
    for column, axis in enumerate("xyz"):
        found[axis] = places[:, column]
    return found
