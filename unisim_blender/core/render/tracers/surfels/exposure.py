"""Exposure differences of images, estimated from places that several of them show.

A camera that looks at the bright sky and one that looks at a shaded wall are exposed otherwise, and faces that are
painted from both would be a patchwork.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....geometry import FloatArray

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
