"""Exposures of images, told by the places that several of them show."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.core.data.exposures import Exposures
from unisim_blender.core.errors import SceneError
from unisim_blender.core.json_file import Node
from unisim_blender.core.render.tracers.surfels.exposure import Observations, exposure_gains


def observations(gains: NDArray[np.float64], odd: float, seed: int = 0) -> Observations:
    """400 places, each shown by three of the images; a share ``odd`` of the observations shows something else."""
    rng = np.random.default_rng(seed)
    place = np.repeat(np.arange(400), 3)
    image = np.concatenate([rng.choice(len(gains), 3, replace=False) for _ in range(400)])
    colour = rng.uniform(40, 140, (400, 3))[place] * gains[image] * np.exp(rng.normal(0, 0.02, (1200, 3)))
    colour[rng.random(1200) < odd] = rng.uniform(10, 240, 3)
    return Observations(place, image, colour.astype(np.float32))


@pytest.mark.parametrize("odd", [0.0, 0.15])
def test_gains_are_found_though_some_places_look_otherwise(odd: float) -> None:
    true = np.array([[1.0, 1.1, 0.9], [0.7, 0.8, 0.75], [1.3, 1.2, 1.4], [1.0, 1.0, 1.0]])
    found = exposure_gains(observations(true, odd), 4)
    ratio = found / true
    # what all images have in common cannot be told
    assert np.abs(ratio / ratio.mean(0) - 1).max() < 0.05


def test_equal_images_have_no_gain() -> None:
    assert np.abs(exposure_gains(observations(np.ones((5, 3)), 0.0), 5) - 1).max() < 0.01


def test_images_that_share_nothing_keep_their_exposure() -> None:
    nothing = Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3), np.float32))
    assert np.array_equal(exposure_gains(nothing, 2), np.ones((2, 3)))
    alone = Observations(
        np.arange(200), np.repeat([0, 1], 100), np.repeat([[50.0], [100.0]], 100, 0).repeat(3, 1).astype(np.float32)
    )
    assert np.allclose(exposure_gains(alone, 3), 1)


def test_values_that_are_clipped_tell_nothing() -> None:
    true = observations(np.array([[1.0] * 3, [0.5] * 3]).repeat(2, 0), 0.0)
    clipped = Observations(true.place, true.image, np.where(true.image[:, None] < 2, np.float32(255), true.colour))
    found = exposure_gains(clipped, 4)
    assert np.allclose(found[:2], 1)


def test_exposures_between_the_images() -> None:
    gains = np.array([[2.0] * 3, [1.0] * 3, [5.0] * 3])
    exposures = Exposures.of(["front", "front", "back"], [0.4, 0.2, 0.3], gains)
    assert np.allclose(exposures.at("front", np.array([0.0, 0.3, 0.4, 9.0]))[:, 0], [1, 1.5, 2, 2])
    assert np.allclose(exposures.at("left", np.array([0.3])), 1)
    again = Exposures.from_json(Node(exposures.to_json(), "exposures", SceneError))
    assert np.array_equal(again.at("back", np.array([0.1])), [[5.0] * 3])
