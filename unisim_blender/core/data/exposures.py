"""Exposure and white balance of recorded images, as gains of their colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..json_file import Node


@dataclass(frozen=True)
class Exposures:
    """Exposures of images: by camera, times (K,), seconds, increasing, and gains (K, 3); cameras without images have
    none."""

    by_camera: dict[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)

    @staticmethod
    def of(cameras: Sequence[str], times_s: Sequence[float], gains: FloatArray) -> Exposures:
        """Return the exposures of I images: their cameras, times, seconds, and gains (I, 3)."""
        by_camera = {}
        for name in dict.fromkeys(cameras):
            own = np.array([i for i, camera in enumerate(cameras) if camera == name])
            own = own[np.argsort(np.array(times_s)[own], kind="stable")]
            by_camera[name] = np.array(times_s)[own], gains[own]
        return Exposures(by_camera)

    def at(self, camera: str, time_s: NDArray[Any]) -> FloatArray:
        """Return gains (N, 3) of a camera at times (N,), interpolated between the recorded ones; 1 for a camera without
        any."""
        if camera not in self.by_camera:
            return np.ones((len(time_s), 3))
        times, gains = self.by_camera[camera]
        return np.stack([np.interp(time_s, times, gains[:, k]) for k in range(3)], -1)

    def is_constant(self, camera: str, start_s: float, end_s: float) -> bool:
        """Return whether a camera's gains are the same at all times between two, to the bit."""
        if camera not in self.by_camera:
            return True
        times = self.by_camera[camera][0]
        between = times[(times > start_s) & (times < end_s)]
        gains = self.at(camera, np.concatenate([[start_s], between, [end_s]]))
        return bool((gains == gains[0]).all())

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            name: {"time_s": times.tolist(), "gain": gains.tolist()} for name, (times, gains) in self.by_camera.items()
        }

    @staticmethod
    def from_json(node: Node) -> Exposures:
        """Return the exposures of `to_json`. Raises the node's error."""
        by_camera = {}
        for name, camera in node.members():
            times, gains = camera.key("time_s").array(-1), camera.key("gain").array(-1, 3)
            if not len(times) or len(times) != len(gains):
                camera.fail(f"has {len(times)} times and {len(gains)} gains")
            by_camera[name] = times, gains
        return Exposures(by_camera)
