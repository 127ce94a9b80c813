"""Spray behind vehicles on wet ground, as a row of puffs that stay where a vehicle left them: they widen, rise and thin out.

A vehicle throws up a part of the film under its tyres that grows with the square of its speed. Drops of one size in it have
the cross-section 3 W / D (W water, m³). Puffs hold unequal parts of it, as sprays in sweeps are clusters (Linnhoff et al.
2022). Everything follows from the vehicle's path, its id and the weather's seed: every sensor sees the same puffs.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, invert_pose, transform_points
from ..sensors.rays import Rays
from ..world.classes import motion_of
from ..world.drive import Actor, Camera
from ..world.weather import Weather
from .particles import hashed_units

FILM_M, TYRES_M, DROP_M = 0.0005, 0.4, 0.0002
"""Thickness of the film, width of a vehicle's two tracks, and diameter of a drop, metres."""
THROWN, THROWN_AT_M_S = 0.1, 20.0
"""Part of the film that is in the air behind a vehicle of this speed."""
LEAST_SPEED_M_S, LEAST_LENGTH_M = 3.0, 2.5
"""Speed and length of the slowest and shortest vehicle that leaves spray."""
SPACING_M, FADING_S, MAX_AGE_S = 1.0, 0.8, 2.4
"""Distance between puffs, metres; seconds in which they thin out by a factor e, and after which they are gone."""
LEAST_DEPTH = 0.01
"""Optical depth through its middle of a puff that is looked at."""
RADIUS_M, WIDENING_M_S = 0.3, 0.45
"""Standard deviation of a new puff's extent, and its growth."""


class Puffs(NamedTuple):
    """Puffs: middles (N, 3), world frame, standard deviations of their extents (N,), metres, and the cross-sections (N,) of
    all their drops, m²: extinction is a normal distribution that integrates to it."""

    middles: FloatArray
    radii_m: FloatArray
    cross_m2: FloatArray

    def depth_of(self, which: NDArray[np.int64], rays: Rays, limit_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the optical depths (M,) of puffs ``which`` (M,) along rays (M,) up to ``limit_m`` (M,), and the distances
        (M,) at which the rays are nearest to their middles."""
        to = self.middles[which] - rays.origins
        along = (to * rays.directions).sum(-1)
        beside = (to**2).sum(-1) - along**2
        radius = self.radii_m[which]
        whole = self.cross_m2[which] / (2 * np.pi * radius**2) * np.exp(-beside / (2 * radius**2))
        return np.where(along > 0, whole * part_in_front(limit_m, along, radius), 0.0), along

    def image_depth(
        self, camera: Camera, time_s: float, depth_m: NDArray[np.float32], rows: slice, columns: slice
    ) -> NDArray[np.float32]:
        """Return the optical depths (H, W) of the puffs in front of surfaces with depths (H, W), in these rows and columns
        of a camera's image: puffs are small discs at their middles' distance."""
        total = np.zeros(depth_m.shape, np.float32)
        model = camera.model_at(time_s)
        local = transform_points(invert_pose(camera.world_from_camera.at(time_s)), self.middles)
        ahead = np.flatnonzero(local[:, 2] > 2 * self.radii_m)
        u, v, valid = model.project(local[ahead])
        x, y = (np.arange(count)[part] + 0.5 for part, count in ((columns, model.width), (rows, model.height)))
        for i, at_u, at_v in zip(ahead[valid].tolist(), u[valid].tolist(), v[valid].tolist(), strict=True):
            distance, radius = float(np.linalg.norm(local[i])), float(self.radii_m[i])
            sigma = radius * model.pixels_per_rad / distance
            left, right = np.searchsorted(x, (at_u - 3 * sigma, at_u + 3 * sigma))
            top, bottom = np.searchsorted(y, (at_v - 3 * sigma, at_v + 3 * sigma))
            if left < right and top < bottom:
                across, down = (np.exp(-(((a - b) / sigma) ** 2) / 2) for a, b in
                                ((x[left:right], at_u), (y[top:bottom], at_v)))  # fmt: skip
                spread = np.float32(self.cross_m2[i] / (2 * np.pi * radius**2)) * np.outer(down, across)
                part = total[top:bottom, left:right]
                part += spread * part_in_front(depth_m[top:bottom, left:right], distance, radius)
        return total


def part_in_front(
    limit_m: FloatArray | NDArray[np.float32], middle_m: FloatArray | float, radius_m: FloatArray | float
) -> FloatArray:
    """Return the parts (...) of puffs that are nearer than ``limit_m`` (...), metres: linear over 2.5 standard deviations,
    which is a normal distribution's to 0.06."""
    return np.clip((limit_m - middle_m) / (2.5 * radius_m) + 0.5, 0, 1)


def spray(actors: Iterable[Actor], weather: Weather, time_s: float) -> Puffs:
    """Return the spray of a state's vehicles at a time."""
    parts = [(np.zeros((0, 3)), np.zeros(0), np.zeros(0))]
    for actor in actors if weather.wet else ():
        if motion_of(actor.label) != "rigid" or not actor.present(time_s) or actor.size_m[0] < LEAST_LENGTH_M:
            continue
        poses = actor.world_from_actor.at(np.array([time_s - 1e-3, time_s]))
        speed = float(np.linalg.norm(poses[1, :2, 3] - poses[0, :2, 3])) / 1e-3
        if speed >= LEAST_SPEED_M_S:
            walked_m = float(actor.world_from_actor.walked_at(time_s))
            parts.append(_behind(actor, poses[1], speed, walked_m, weather))
    return Puffs(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _behind(
    actor: Actor, pose: FloatArray, speed: float, walked_m: float, weather: Weather
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return middles, extents and cross-sections of the puffs behind a vehicle, each at a multiple of a distance of its way."""
    length, width, height = actor.size_m
    wheels_m = walked_m - 0.35 * length
    first, last = math.ceil((wheels_m - MAX_AGE_S * speed) / SPACING_M), math.floor(wheels_m / SPACING_M)
    number = np.arange(first, last + 1)
    age_s = (wheels_m - number * SPACING_M) / speed
    cells = np.stack([number, 0 * number, 0 * number], 1)
    aside, above, unequal = hashed_units(cells, (weather.seed, zlib.crc32(actor.uid.encode()))).T
    radius = RADIUS_M + WIDENING_M_S * age_s
    side = np.where(number % 2, 1, -1) * 0.4 * width + (aside - 0.5) * radius
    up = -height / 2 + radius + (above - 0.3) * radius
    local = np.stack([number * SPACING_M - walked_m, side, up], 1)
    thrown = weather.wet * THROWN * min((speed / THROWN_AT_M_S) ** 2, 4.0)
    cross = 3 * FILM_M * TYRES_M * SPACING_M * thrown / DROP_M * np.exp(-age_s / FADING_S) * -np.log(unequal)
    some = cross >= LEAST_DEPTH * 2 * math.pi * radius**2
    return transform_points(pose, local[some]), radius[some], cross[some]
