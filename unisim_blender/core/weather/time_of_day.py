"""Time of day in images, as a look: what was recorded by day, shown as if the sun stood lower.

The light on level ground falls with the sun's elevation as it was measured (Seidelmann, Explanatory Supplement to the
Astronomical Almanac, 1992, after Bond & Henderson 1963), and a town's own light comes to it. A camera adapts, so that its
image gets darker by a small power of that alone. Moving vehicles have head lamps, and a scenario places street lamps. No
light is followed on its way: lamps cast no shadows, and walls keep the sun that they were recorded in.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb, srgb_from_linear
from ..geometry import BoolArray, FloatArray, invert_pose, transform_points
from ..sensors.frames import CameraFrame
from ..sensors.rays import Rays
from ..world.classes import motion_of
from ..world.drive import Actor
from ..world.replay import WorldState
from ..world.weather import LAMPS_DEG, Weather
from .camera import LUMINANCE
from .wet_ground import GROUND_M

ELEVATIONS_DEG = (-18, -12, -6, -5, -0.8, 0, 5, 10, 15, 20, 30, 40, 50, 60, 70, 80, 90)
DAYLIGHT_LX = (
    6.51e-4, 8.31e-3, 3.4, 10.8, 453, 732, 4760, 10900, 18600, 27300, 47000, 66700, 85000, 102000, 113000, 120000, 124000
)  # fmt: skip
TOWN_LX, REST_LX = 8.0, 2.0
"""Light of a town at night on its ground, of lamps that nobody has recorded; and what is left of it at stated ones."""
ADAPTED = 0.19
"""Power of the light by which a camera's image gets darker."""
TWILIGHT, LOW_SUN, TOWN = (0.80, 0.95, 1.35), (1.08, 1.0, 0.88), (1.25, 1.0, 0.74)
"""Colours of the light when the sun is down, low, and of the town, relative to the recorded light."""
TOWN_SKY, TWILIGHT_SKY = 0.25, 2.5
"""Brightness of the sky by the town's light, and when the sun is down, relative to the ground's as it was recorded."""
DIRECT_DEG, LOW_DEG = 10.0, 30.0
"""Elevations below which the sun's shadows fade, of which there are none at 0, and below which its light gets redder."""
SHADE, LIFT = (0.35, 0.6), (2.5, 2.4, 2.0)
"""Brightness of ground relative to that in the sun, below which it is in shade, and above which not; and what it gains then."""
LAMP_CD, SPREAD_CD, GLARE_CD = 12000.0, 4000.0, 400.0
"""A dipped lamp's intensity along its axis, near the vehicle, and above the cut-off, candela."""
LAMP_REACH_M, LAMP_SIZE_M, LAMP_DEPTH_M, LAMP_HEIGHT_M = 80.0, 0.12, 0.6, 0.65
"""How far a lamp shines, its radius, how far from a box's end its surface may be, and its height above the ground."""
HEAD_LAMP, TAIL_LAMP = (1.0, 0.96, 0.85), (0.85, 0.03, 0.02)
LAMPS_APART, EGO_WIDTH_M, EGO_FRONT_M = 0.72, 1.8, 2.0
"""Distance of a vehicle's lamps relative to its width; the ego vehicle's width, and where its front is."""
STANDING_M, UPRIGHT = 0.35, 0.7
"""Height above the ground from which on what stands is lit as if it faced the lamps, and the cosine that it then has."""
LEAST_LENGTH_M = 2.5
"""Length of the shortest vehicle with lamps."""
STREET_LM, CUT_OFF = 5000.0, 0.26
"""A street lamp's flux, lumen, and the cosine of the angle from straight down from which on it dims, to nothing at 90°."""
STREET_REACH_M, STREET_HEAD_M, STREET_HEAD, NEAR_RAYS_M = 50.0, 0.2, (1.0, 0.93, 0.75), 3.0
"""How far a street lamp shines, fading; the radius and the colour of its head, and how near to it rays are looked at."""


class Lamps(NamedTuple):
    """A vehicle's two head lamps at ``pose`` (4, 4), world frame, x ahead, ``aside_m`` to either side."""

    pose: FloatArray
    aside_m: float

    def light(self, points: FloatArray, level: FloatArray) -> FloatArray:
        """Return the light (N,), lux, on points (N, 3), world frame, of what faces the lamps and, for a part ``level`` (N,), of
        level ground."""
        total = np.zeros(len(points))
        local = transform_points(invert_pose(self.pose), points)
        near = np.flatnonzero(
            (local[:, 0] > 0.2) & (local[:, 0] < LAMP_REACH_M) & (np.abs(local[:, 1]) < local[:, 0] + 2)
        )
        for side in (-self.aside_m, self.aside_m):
            x, y, z = (local[near] - [0, side, 0]).T
            distance = np.sqrt(x**2 + y**2 + z**2)
            up, across = np.degrees(np.arctan2(z, x)), np.degrees(np.arctan2(y, x))
            below = 1 / (1 + np.exp((up + 0.8) / 0.15))
            candela = LAMP_CD * np.exp(-(((up + 1.5) / 1.6) ** 2) - (across / 12) ** 2) * below
            candela += SPREAD_CD * np.exp(-(((up + 4) / 6) ** 2) - (across / 28) ** 2) * below
            candela += GLARE_CD * np.exp(-((up / 12) ** 2) - (across / 25) ** 2)
            facing = UPRIGHT + level[near] * (np.maximum(-z / distance, 0) - UPRIGHT)
            total[near] += candela * facing / np.maximum(distance, 1.0) ** 2
        return total


def street_light(heads: FloatArray, points: FloatArray, level: FloatArray) -> FloatArray:
    """Return the light (N,), lux, of street lamps with heads (L, 3) on points (N, 3), world frame: for a part ``level`` (N,) of
    level ground, else of walls, the mean over all directions that these may face. It is alike all around, and goes as 1 + 2
    sin² of the angle from straight down up to 75°."""
    total, u = np.zeros(len(points)), CUT_OFF
    flux = 2 * np.pi * (3 * (1 - u) - 2 / 3 * (1 - u**3) + 1.5 * u - 0.5 * u**3)
    x, y, z = np.ascontiguousarray(points.T)
    for head in heads:
        aside = (x - head[0]) ** 2 + (y - head[1]) ** 2
        near = np.flatnonzero(aside < STREET_REACH_M**2)
        distance = np.maximum(np.sqrt(aside[near] + (head[2] - z[near]) ** 2), 1e-6)
        down = (head[2] - z[near]) / distance
        candela = STREET_LM / flux * (3 - 2 * down**2) * np.clip(down / u, 0, 1)
        fade = np.clip(1 - (distance / STREET_REACH_M) ** 4, 0, 1)
        wall = np.sqrt(aside[near]) / distance / np.pi
        facing = wall + level[near] * (np.maximum(down, 0) - wall)
        total[near] += candela * fade * facing / np.maximum(distance, 1.0) ** 2
    return total


def street_heads(weather: Weather, heights: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return where the heads (L, 3) of the street lamps are, world frame, always in the same order."""
    heads = np.array(sorted(weather.street_lamps), np.float64).reshape(-1, 3)
    heads[:, 2] -= heights(heads * [1, 1, 0])
    return heads


class HourLight(NamedTuple):
    """What the colours of ground and sky are multiplied by, (3,) each; the part of the recorded sun that still shines, 0 to 1;
    by how much the light of one lux is multiplied, relative to the recorded light; and what of ``ground`` is the town's."""

    ground: FloatArray
    sky: FloatArray
    direct: float
    per_lx: float
    town: FloatArray


def light_of(elevation_deg: float) -> HourLight:
    """Return the light when the sun stands at an elevation."""
    day, by_day = (float(10 ** np.interp(x, ELEVATIONS_DEG, np.log10(DAYLIGHT_LX))) for x in (elevation_deg, 90.0))
    level, part = ((day + TOWN_LX) / by_day) ** ADAPTED, day / (day + TOWN_LX)
    direct = float(np.clip(elevation_deg / DIRECT_DEG, 0, 1))
    low, down = np.clip(1 - elevation_deg / LOW_DEG, 0, 1), np.clip(-elevation_deg / 6, 0, 1)
    tint = part * (1 + low * (np.array(LOW_SUN) - 1) + down * (np.array(TWILIGHT) - np.array(LOW_SUN)))
    town = (1 - part) * np.array(TOWN)
    above = tint * (1 + (TWILIGHT_SKY - 1) * (1 - direct)) + TOWN_SKY * town
    return HourLight(level * (tint + town), level * above, direct, level / (day + TOWN_LX), level * town)


def shown(
    frame: CameraFrame, state: WorldState, uids: Sequence[str], weather: Weather, sky: BoolArray, rays: Rays,
    heights: Callable[[FloatArray], FloatArray], full_sun: float,
) -> NDArray[np.float32]:  # fmt: skip
    """Return the colours (H, W, 3), sRGB, of a frame by day with depths and instances of ``uids``, as if the sun stood as
    ``weather`` says. Its ``rays`` (H, W) show ``sky`` (H, W) or what stands; ``heights`` returns heights above the ground, and
    ``full_sun`` is the luminance of ground in the sun."""
    assert frame.depth_m is not None and frame.instance is not None
    lamps_on = weather.sun_elevation_deg < LAMPS_DEG
    heads = street_heads(weather, heights) if lamps_on else np.zeros((0, 3))
    light = light_of(weather.sun_elevation_deg)
    solid = ~sky & np.isfinite(frame.depth_m) & np.isfinite(rays.directions).all(-1)
    colours = linear_from_srgb(frame.rgb)
    out = np.minimum(colours * light.sky, 1)
    seen, instance = colours[solid], frame.instance[solid]
    points = rays.origins[solid] + rays.directions[solid] * frame.depth_m[solid, None]
    above = np.abs(heights(points))
    ground = (instance == 0) & (above < GROUND_M)
    if full_sun > 0:
        # the sky's light alone falls on ground in the sun and in shade alike
        share = seen[ground] @ LUMINANCE / full_sun
        shade = np.clip((SHADE[1] - share) / (SHADE[1] - SHADE[0]), 0, 1) * (1 - light.direct)
        seen[ground] *= (np.array(LIFT) ** shade[:, None]).astype(np.float32)
    ground_light = light.ground
    if len(heads):
        # stated lamps stand for the town's where they shine
        nearest = np.min([np.hypot(*(points[:, :2] - head[:2]).T) for head in heads], axis=0)
        missing = (1 - REST_LX / TOWN_LX) * np.clip(1 - (nearest / STREET_REACH_M) ** 2, 0, 1)
        ground_light = ground_light - missing[:, None] * light.town
    dim = np.minimum(seen * ground_light, 1)
    if lamps_on:
        level = np.clip((STANDING_M - above) / (STANDING_M - GROUND_M), 0, 1)
        lit = np.sum([lamps.light(points, level) for lamps in head_lamps(state, heights)], axis=0)[:, None]
        if len(heads):
            lit = lit + street_light(heads, points, level)[:, None] * TOWN
        dim = 1 - (1 - dim) * np.exp(-seen * (light.per_lx * lit))
        _glow(dim, instance, uids, state, points)
    out[solid] = dim
    _street_glow(out, heads, rays, np.where(sky, np.inf, frame.depth_m))
    return srgb_from_linear(out.astype(np.float32))


def head_lamps(state: WorldState, heights: Callable[[FloatArray], FloatArray]) -> Iterator[Lamps]:
    """Yield the lamps of the ego vehicle and of moving ones."""
    middle = (state.start_s + state.end_s) / 2
    ego = state.world_from_ego.at(middle).copy()
    ego[:3, 3] += ego[:3, 0] * EGO_FRONT_M
    ego[2, 3] += LAMP_HEIGHT_M - float(heights(ego[None, :3, 3])[0])
    yield Lamps(ego, LAMPS_APART * EGO_WIDTH_M / 2)
    for actor in vehicles(state):
        pose, size = actor.world_from_actor.at(middle).copy(), actor.size_m
        pose[:3, 3] += pose[:3, :3] @ [size[0] / 2, 0, LAMP_HEIGHT_M - size[2] / 2]
        yield Lamps(pose, LAMPS_APART * float(size[1]) / 2)


def vehicles(state: WorldState) -> Iterator[Actor]:
    """Yield the actors that have lamps on."""
    for actor in state.actors:
        if actor.is_moving and motion_of(actor.label) != "deforming" and actor.size_m[0] >= LEAST_LENGTH_M:
            yield actor


def _glow(
    colours: FloatArray, instance: NDArray[np.int32], uids: Sequence[str], state: WorldState, points: FloatArray
) -> None:
    """Let the lamps of moving vehicles shine in linear colours (N, 3) of points (N, 3), in place: white in front, red behind."""
    middle = (state.start_s + state.end_s) / 2
    for actor in vehicles(state):
        mine = np.flatnonzero(instance == uids.index(actor.uid) + 1) if actor.uid in uids else np.zeros(0, np.int64)
        local = transform_points(invert_pose(actor.world_from_actor.at(middle)), points[mine])
        length, width, height = actor.size_m
        for end, colour, up in ((1, HEAD_LAMP, LAMP_HEIGHT_M), (-1, TAIL_LAMP, height / 2)):
            aside = np.abs(np.abs(local[:, 1]) - LAMPS_APART * width / 2)
            off = np.hypot(aside, local[:, 2] + height / 2 - up) / LAMP_SIZE_M
            bright = np.clip(1.5 - off, 0, 1) * (end * local[:, 0] > length / 2 - LAMP_DEPTH_M)
            colours[mine] += bright[:, None] * (np.array(colour) - colours[mine])


def _street_glow(colours: FloatArray, heads: FloatArray, rays: Rays, depth_m: FloatArray) -> None:
    """Let the heads (L, 3) of street lamps shine in linear colours (H, W, 3), in place, where nothing at ``depth_m`` (H, W) is
    nearer."""
    flat, shown, depth_m = rays.flat(), colours.reshape(-1, 3), depth_m.reshape(-1)
    for head in heads:
        # rays start within a metre of each other: others than those about the head are left out soon
        away = head - flat.origins[0]
        near = np.flatnonzero(flat.directions @ away > max(float(away @ away) - NEAR_RAYS_M**2, 0.0) ** 0.5)
        away = head - flat.origins[near]
        along = (away * flat.directions[near]).sum(1)
        off = np.sqrt(np.maximum((away**2).sum(1) - along**2, 0)) / STREET_HEAD_M
        bright = np.clip(1.5 - off, 0, 1) * ((along > 0) & (along < depth_m[near] + 2 * STREET_HEAD_M))
        shown[near] += bright[:, None] * (STREET_HEAD - shown[near])
