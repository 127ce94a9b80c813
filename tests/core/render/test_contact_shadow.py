"""Soft shadows: dark under the body, nothing far away, nothing on actors, nothing for actors that are not there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tiny_drive import tiny_drive

from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.render.contact_shadow import MAX_DARKENING, SHADOW_CUTOFF_M, shaded

CAR = replace(
    tiny_drive().actors["car"],
    world_from_actor=Trajectory(
        np.zeros(1), np.array([[0.0, 0.0, 0.75]]), np.array([[np.cos(0.3), 0, 0, np.sin(0.3)]])
    ),
)
X, Y = np.meshgrid(np.linspace(-8, 8, 65), np.linspace(-8, 8, 65))
GROUND = np.stack([X, Y, np.zeros_like(X)], -1)
GREY = np.full((65, 65, 3), 0.5, np.float32)
EVERYWHERE = np.ones((65, 65), bool)


def test_dark_under_the_body_and_nothing_far_away() -> None:
    out = shaded(GREY, GROUND, EVERYWHERE, [CAR], 0.0)
    linear = (out[32, 32, 0] + 0.055) / 1.055
    lit = ((0.5 + 0.055) / 1.055) ** 2.4
    assert abs(linear**2.4 / lit - (1 - MAX_DARKENING)) < 0.01
    far = np.hypot(X, Y) > np.hypot(*CAR.size_m[:2]) / 2 + SHADOW_CUTOFF_M
    assert np.abs(out[far] - 0.5).max() < 0.003
    # it follows the turned body: further along it than across it
    ahead, left = np.array([np.cos(0.6), np.sin(0.6)]), np.array([-np.sin(0.6), np.cos(0.6)])

    def at(place: FloatArray) -> float:
        i, j = np.unravel_index(np.hypot(X - place[0], Y - place[1]).argmin(), X.shape)
        return float(out[i, j, 0])

    assert at(1.8 * ahead) < at(1.8 * left) - 0.05


def test_actors_and_what_is_absent_are_left_alone() -> None:
    ground = EVERYWHERE.copy()
    ground[30:35, 30:35] = False
    out = shaded(GREY, GROUND, ground, [CAR], 0.0)
    assert (out[30:35, 30:35] == 0.5).all()
    assert shaded(GREY, GROUND, EVERYWHERE, [replace(CAR, start_s=1.0)], 0.0) is GREY
    assert shaded(GREY, GROUND, EVERYWHERE, [], 0.0) is GREY
