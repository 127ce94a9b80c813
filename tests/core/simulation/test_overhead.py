"""The picture from above: where things lie in it, and what is drawn over what."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unisim_blender.core.export.film import (
    AHEAD_M,
    BEHIND_M,
    BOX,
    EGO_BOX,
    PLANNED,
    Overhead,
    colours_of,
)
from unisim_blender.core.simulation.states import EgoState, Footprint
from unisim_blender.core.world.drive import EGO

PIXELS = 140
SCALE = PIXELS / (AHEAD_M + BEHIND_M)


@pytest.mark.parametrize("heading", [0.0, 1.1, -2.5])
def test_ahead_is_up_and_left_is_left(heading: float) -> None:
    view = Overhead(EgoState(100.0, -40.0, heading, 5.0), PIXELS)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    points = np.array([100.0, -40.0]) + [0 * ahead, 10 * ahead, 5 * left]
    axle = np.array([PIXELS / 2, AHEAD_M * SCALE])
    np.testing.assert_allclose(view.place(points), axle + SCALE * np.array([[0, 0], [0, -10], [-5, 0]]), atol=1e-9)


def test_what_is_drawn() -> None:
    view = Overhead(EgoState(0.0, 0.0, 0.0, 5.0), PIXELS)
    ego = Footprint(EGO, "Car", 1.4, 0.0, 0.0, 4.5, 1.9, 5.0)
    car = Footprint("car-01", "Car", 20.0, 6.0, 0.2, 4.5, 1.9, 5.0)
    returns = np.array([[30.0, -10.0, 0.0], [30.0, -10.0, 2.9], [1000.0, 0.0, 1.0]])
    picture = view.draw(returns, [car], ego, np.array([[0.0, 0.0], [40.0, 0.0]]), np.zeros((0, 2)))
    assert picture.shape == (PIXELS, PIXELS, 3)

    def colours(points: object) -> np.ndarray:  # type: ignore[type-arg]
        column, row = np.floor(view.place(np.array([points]))[0]).astype(int)
        return picture[row, column]

    np.testing.assert_array_equal(colours((30.0, -10.0)), colours_of(np.array([2.9]))[0])
    assert (picture == EGO_BOX).all(-1).sum() > 10 and (picture == BOX).all(-1).sum() > 10
    assert (picture == PLANNED).all(-1)[: int((AHEAD_M - 5) * SCALE)].sum() > 20


def test_heights_have_colours_of_their_own() -> None:
    found = colours_of(np.array([-5.0, 0.0, 1.5, 3.0, 50.0])).astype(int)
    assert len(np.unique(found, axis=0)) == 4 and (found[0] != found[1]).any() and (found[3] == found[4]).all()
