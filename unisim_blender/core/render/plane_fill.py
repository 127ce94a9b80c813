"""The ground and the façades that nobody saw, filled with what was seen of the same street.

The ground around a drive is a map of texels, whose rows go along the drive, and so is each large vertical plane beside it, whose
rows go along the wall. A texel that some recorded image shows has the colour that the trained scene gives it there; one that
some sweep shows has its intensity. The others are filled from those of their own rows, ahead and behind, and where these have
none from those beside: lanes, kerbs and markings go on along a street, plinths and storeys along a wall. The maps are a
property of the scene: all frames, cameras and LiDARs show the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray, bilinear, box_sums, transform_points
from ..sensors.rays import Rays
from ..weather.wet_ground import GROUND_M
from ..world.drive import Camera, Lidar
from .tracer import Array

FILL_VERSION = 3
"""Version of the cached maps: to be raised when the same scene gives another map."""
TEXEL_M, MAX_TEXELS = 0.1, 2**22
"""Edge of a texel, metres, of which longer drives have larger ones; and the largest number of them."""
REACH_M = 45.0
"""Distance from a sensor, metres, up to which it shows texels."""
FILLED_M = 4.0
"""Distance from what was seen, metres, up to which a plane is filled."""
UNSURE_TEXELS, FEATHER_TEXELS = 2, 3
"""Texels beside those that were seen that are not filled, and over how many the filling grows from there."""
ON_SURFACE_M, PROBE_M = 0.3, 1.0
"""Largest distance of the scene's surface from a texel that it shows, and of the beginning of a ray to it, metres."""
FACADE_M, RELIEF_M = 0.5, 0.2
"""Largest distance of the scene's surface from the plane of a façade, and of what a ray hits from that surface, metres."""
COLOUR_PART, THROUGH_PART = 0.8, 0.9
"""Largest part of a colour that is replaced, and that of a ray that goes on to a plane: the mean of two guesses is better than
either."""
ALONG = 5
"""How often a map is halved along its rows, before it is halved in both directions."""
STEPS, UNEVEN_M, BESIDE_M = 14, 1.0, 2.0
"""Number of bisections that look for where a ray hits a plane's surface; how far below level ground, and how far beside a plane's
texels it may, metres."""


SensorKind = type[Camera] | type[Lidar]


@dataclass(frozen=True)
class Texture:
    """A map of texels: ``values`` (X, Y, C), and ``share`` (X, Y, 1), 0 to 1, how much of each replaces what the scene has."""

    values: Array
    share: Array


@dataclass(frozen=True)
class TexturedPlane:
    """The ground, or a façade: texels of edge ``texel_m``, the first at the origin of the grid, whose x is along the drive or the
    wall, y across or up, z off it. ``relief`` (X, Y, 1): how far off the scene's surface is, metres; None of the ground.
    ``textures``: of cameras colours (X, Y, 3) as the decoder gives them, of LiDARs, on the ground, intensities (X, Y, 1)."""

    grid_from_world: FloatArray
    texel_m: float
    relief: Array | None
    textures: Mapping[SensorKind, Texture]

    def at(self, kind: SensorKind, points: FloatArray) -> tuple[NDArray[np.int64], Array, Array, FloatArray]:
        """Return the numbers (M,) of those points (N, 3), world frame, that have a share above 0, the texture's values (M, C) and
        shares (M, 1) there, bilinear between texels, and how far they are off the relief (M,), 0 without one."""
        local, texture = transform_points(self.grid_from_world, points), self.textures[kind]
        v, u, within = self._texels(local)
        if self.relief is not None:
            within &= np.abs(local[:, 2]) < FACADE_M
        number = np.flatnonzero(within)
        share = bilinear(texture.share, u[number], v[number])
        number, share = number[share[:, 0] > 0], share[share[:, 0] > 0]
        u, v, off = u[number], v[number], np.zeros(len(number))
        if self.relief is not None:
            off = np.abs(local[number, 2] - bilinear(self.relief, u, v)[:, 0])
        return number, bilinear(texture.values, u, v), share, off

    def hit(
        self, kind: SensorKind, rays: Rays, start_m: FloatArray, heights: Callable[[FloatArray], FloatArray]
    ) -> tuple[FloatArray, Array]:
        """Return the distances (N,), metres, beyond ``start_m`` (N,) at which flat rays (N,) hit the ground from above, or the
        relief, by bisection, inf where they do not, and the texture's values (N, C) there, NaN without one."""
        turn, texture = self.grid_from_world[:3, :3], self.textures.get(kind)
        toward, off_plane = (np.einsum("j,nj->n", turn[2], x) for x in (rays.directions, rays.origins))
        off_plane += self.grid_from_world[2, 3]
        side = np.ones(len(toward)) if self.relief is None else np.sign(off_plane)
        some = np.flatnonzero(side * toward < -1e-3)
        if self.relief is not None:
            flat = rays.origins[some] - (off_plane[some] / toward[some])[:, None] * rays.directions[some]
            some = some[self._texels(np.einsum("ij,nj->ni", turn, flat) + self.grid_from_world[:3, 3], BESIDE_M)[2]]
        origins, directions, toward, side = rays.origins[some], rays.directions[some], toward[some], side[some]

        def at(distance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
            """Return how far places along the rays are off the surface, their rows and columns, and whether texels are there."""
            points = origins + distance[:, None] * directions
            local = np.einsum("ij,nj->ni", turn, points) + self.grid_from_world[:3, 3]
            v, u, within = self._texels(local)
            off = heights(points) if self.relief is None else side * (local[:, 2] - bilinear(self.relief, u, v)[:, 0])
            return off, v, u, within

        near = start_m[some]
        if self.relief is None:
            far = np.minimum(near + (at(near)[0] + UNEVEN_M) / -toward, near + 4 * REACH_M)
        else:
            near = np.maximum(near, (FACADE_M - np.abs(off_plane[some])) / (side * toward))
            far = (-FACADE_M - np.abs(off_plane[some])) / (side * toward)
        crossed = (far > near) & (at(near)[0] > 0) & (at(far)[0] < 0)
        for _ in range(STEPS):
            middle = (near + far) / 2
            before = at(middle)[0] > 0
            near, far = np.where(before, middle, near), np.where(before, far, middle)
        _, v, u, within = at(near)
        hit = crossed & within
        out = np.full(len(start_m), np.inf)
        out[some[hit]] = near[hit]
        values = np.full((len(start_m), 1 if texture is None else texture.values.shape[2]), np.nan, np.float32)
        if texture is not None:
            values[some[hit]] = bilinear(texture.values, u[hit], v[hit])
        return out, values

    def _texels(self, local: FloatArray, beside_m: float = 0.0) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return the rows and columns (N,) of places (N, 3) of the grid, and which of them have texels around them, or at most so
        far beside."""
        v, u = local[:, :2].T / self.texel_m
        height, width = next(iter(self.textures.values())).share.shape[:2]
        low = 0.5 - beside_m / self.texel_m
        return v, u, (v >= low) & (v <= height - low) & (u >= low) & (u <= width - low)


@dataclass(frozen=True)
class PlaneFill:
    """The textured planes of a scene, the ground first."""

    planes: tuple[TexturedPlane, ...]

    def of(
        self, kind: SensorKind, points: FloatArray, heights: Callable[[FloatArray], FloatArray]
    ) -> tuple[NDArray[np.int64], Array, Array]:
        """Return the numbers (M,) of those points (N, 3), world frame, that a plane fills for sensors of a kind, of several the
        closest; its values (M, C) and shares (M, 1) there. ``heights`` gives heights (N,) above the ground."""
        off, share = np.full(len(points), np.inf), np.zeros((len(points), 1), np.float32)
        values = np.zeros((len(points), self.planes[0].textures[kind].values.shape[2]), np.float32)
        for plane in (each for each in self.planes if kind in each.textures):
            number, theirs, part, away = plane.at(kind, points)
            if plane.relief is None:
                away = np.abs(heights(points[number]))
            near = away < np.minimum(GROUND_M if plane.relief is None else RELIEF_M, off[number])
            number = number[near]
            off[number], values[number], share[number] = away[near], theirs[near], part[near]
        some = np.flatnonzero(share[:, 0])
        return some, values[some], share[some]

    def hit(
        self, kind: SensorKind, rays: Rays, start_m: FloatArray, heights: Callable[[FloatArray], FloatArray]
    ) -> tuple[FloatArray, Array, FloatArray]:
        """Return the distances (N,), metres, beyond ``start_m`` (N,) at which flat rays (N,) hit the first plane, inf where there
        is none, its values (N, C), NaN without a texture, and its normal (N, 3) there, world frame, against the ray."""
        distance, normals = np.full(len(start_m), np.inf), np.zeros((len(start_m), 3))
        values = np.zeros((len(start_m), self.planes[0].textures[kind].values.shape[2]), np.float32)
        for plane in self.planes:
            there, theirs = plane.hit(kind, rays, start_m, heights)
            nearer = there < distance
            distance[nearer], values[nearer] = there[nearer], theirs[nearer]
            normals[nearer] = plane.grid_from_world[2, :3]
        normals *= -np.sign((normals * rays.directions).sum(1, keepdims=True))
        return distance, values, normals


def share_of(known: BoolArray, seen: BoolArray, texel_m: float) -> Array:
    """Return how much of the map (X, Y, 1) is filled: texels that were not ``seen`` (X, Y), beside those that are ``known``."""
    wanted = (box_sums(known, round(FILLED_M / texel_m)) > 0) & (box_sums(seen, UNSURE_TEXELS) == 0)
    grown = box_sums(wanted, FEATHER_TEXELS // 2) / FEATHER_TEXELS**2
    return np.where(seen, 0, grown)[..., None].astype(np.float32)


def filled(values: Array, known: BoolArray, along: int = ALONG) -> Array:
    """Return values (X, Y, C) in which those that are not ``known`` (X, Y) are interpolated from coarser ones: means of pairs
    along the first axis, ``along`` times, then of fours (Gortler et al., "The Lumigraph", SIGGRAPH 1996, section 3.4)."""
    if known.all() or not known.any():
        return np.where(known[..., None], values, np.float32(0))
    axes = [axis for axis in ((0,) if along > 0 and len(known) > 1 else (0, 1)) if known.shape[axis] > 1]
    weights = known.astype(np.float32)[..., None]
    total, pad = values * weights, [(0, known.shape[axis] % 2 if axis in axes else 0) for axis in (0, 1)]
    for axis in axes:
        total, weights = (_paired(np.pad(x, (*pad, (0, 0))) if axis == axes[0] else x, axis) for x in (total, weights))
    coarse = filled(total / np.maximum(weights, 1), weights[..., 0] > 0, along - 1)
    for axis in axes:
        coarse = _doubled(coarse, axis, known.shape[axis])
    return np.where(known[..., None], values, coarse)


def _paired(values: Array, axis: int) -> Array:
    """Return the sums of pairs along an axis of even length."""
    return np.asarray(
        values.take(range(0, values.shape[axis], 2), axis) + values.take(range(1, values.shape[axis], 2), axis)
    )


def _doubled(values: Array, axis: int, count: int) -> Array:
    """Return values with ``count`` places along an axis in place of half as many, linear between these."""
    place = np.clip((np.arange(count) + 0.5) / 2 - 0.5, 0, values.shape[axis] - 1).astype(np.float32)
    low = place.astype(np.int64)
    high = np.minimum(low + 1, values.shape[axis] - 1)
    part = (place - low).reshape([-1 if each == axis else 1 for each in range(values.ndim)])
    return np.asarray((1 - part) * values.take(low, axis) + part * values.take(high, axis))
