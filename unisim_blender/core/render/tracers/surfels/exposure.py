"""Exposure differences of images, estimated from places that several of them show.

A camera that looks at the bright sky and one that looks at a shaded wall are exposed otherwise, and faces that are
painted from both would be a patchwork.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....geometry import FloatArray
from ....json_file import Node

ITERATIONS = 20
MIN_VALUE, MAX_VALUE = 8.0, 247.0
"""Smallest and largest value of an image, of 255, that is used."""
OUTLIER_SHARE = 0.15
"""Relative difference of a place's colours, beyond that of exposures, at which it counts half: reflections,
occlusions."""
PRIOR_PLACES = 10.0
"""Weight of the prior of no exposure difference: as many places that say otherwise move an image half of the way."""


@dataclass(frozen=True)
class Observations:
    """Colours of places in images: place (N,) and image (N,) numbers, colour (N, 3) in 0..255."""

    place: NDArray[np.int64]
    image: NDArray[np.int64]
    colour: NDArray[np.float32]


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


def exposure_gains(observations: Observations, images: int) -> FloatArray:
    """Return gains (images, 3), near 1, by which images' colours are divided so that they agree on places.

    Least squares of ``log colour = place + image`` by turns, robust to places that look otherwise from elsewhere
    (Cauchy's weights; Holland and Welsch, "Robust regression using iteratively reweighted least-squares", 1977). Each
    channel's mean gain over all observations is 1.
    """
    log_gain = np.zeros((images, 3))
    usable = ((observations.colour > MIN_VALUE) & (observations.colour < MAX_VALUE)).all(1)
    _, place = np.unique(observations.place[usable], return_inverse=True)
    image, colour = observations.image[usable], np.log(observations.colour[usable].astype(np.float64))
    if len(place) == 0:
        return np.exp(log_gain)
    weight = np.ones(len(place))
    for _ in range(ITERATIONS):
        mean = _means(place, weight, colour - log_gain[image])
        residual = colour - mean[place]
        log_gain = _means(image, weight, residual, images, PRIOR_PLACES)
        log_gain -= np.average(log_gain, axis=0, weights=np.bincount(image, minlength=images))
        odd = np.abs(residual - log_gain[image]).max(1)
        weight = 1 / (1 + (odd / OUTLIER_SHARE) ** 2)
    return np.exp(log_gain)


def _means(
    group: NDArray[np.int64], weight: FloatArray, values: FloatArray, groups: int | None = None, prior: float = 1e-9
) -> FloatArray:
    """Return weighted means (G, 3) of values (N, 3) by group (N,), drawn to 0 by ``prior``."""
    count = int(group.max()) + 1 if groups is None else groups
    total = np.bincount(group, weight, count) + prior
    return np.stack([np.bincount(group, weight * values[:, k], count) for k in range(3)], -1) / total[:, None]
