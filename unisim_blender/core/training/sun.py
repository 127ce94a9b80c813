"""The sun of a recording: whether there is any, how strong, where it stands, and where it shone on the ground.

Sunlight splits the ground's brightness into two classes, between them lies the sun's part. Its direction is that in
which boxes of moving actors throw shadows that darken the ground where it was brighter in other images: what the ground
is made of, and shadows that stand still, cancel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..data.log import Log
from ..geometry import BoolArray, FloatArray, points_in_box, spread_indices
from ..render.tracers.surfels.ground import HeightGrid, fill, height_grid
from ..sensors.camera import camera_rays
from ..world.drive import Actor, Drive
from ..world.light import Sun, SunlitGround
from ..world.replay import parked_boxes

SWEEPS, IMAGES = 20, 24
"""Largest number of sweeps, and of images of each camera."""
COLUMNS, NEAR_M = 300, 30.0
"""Columns of pixels of an image, and the distance up to which they count."""
CELL_M, GROUND_CELL_M = 0.2, 0.25
LEAST_IMAGES = 4
"""Number of pixels that a place on the ground must have."""
BEFORE_BLACK = 0.004
"""Linear brightness that is added before logarithms."""
LEAST_SEPARATION, LEAST_CERTAINTY = 0.7, 3.0
"""Part of the variance of brightness that two classes explain, above which the sun shines: of any bell-shaped
distribution it is 0.64. Standard deviations of all directions' scores by which the best must lie above 0."""
LEAST_SHADOW_PIXELS = 60
AZIMUTHS_DEG, ELEVATIONS_DEG = np.arange(-180.0, 180.0, 10.0), np.arange(15.0, 80.0, 5.0)


class _Ground(NamedTuple):
    """Pixels (N,) that show ground: points (N, 3), world frame, their logarithms of linear RGB (N, 3), and times."""

    points: FloatArray
    colours: FloatArray
    times_s: FloatArray


def recorded_sun(
    log: Log, cameras: tuple[str, ...], lidars: tuple[str, ...], frames: tuple[int, ...]
) -> dict[str, Any]:
    """Return the sun of a recording as JSON: a `Sun` of strength 0 where no direct sun is certain, its ``certainty``,
    ``separation`` of sunlit and shaded ground, and `SunlitGround` as ``ground`` where it shines. Empty where no ground
    was seen."""
    drive = log.drive
    heights = _heights(log, lidars, frames)
    ground = None if heights is None else _ground_pixels(log, cameras, frames, heights)
    if ground is None or len(ground.points) < 1000:
        return {}
    cells, which = np.unique(
        np.floor(ground.points[:, :2] / GROUND_CELL_M).astype(np.int64), axis=0, return_inverse=True
    )
    colours = _quantile(ground.colours, which.reshape(-1), len(cells), 0.5)
    brightness = colours.mean(1)
    threshold, separation = _split(brightness)
    bright = brightness >= threshold
    ratio = np.exp(np.median(colours[~bright], 0) - np.median(colours[bright], 0))
    azimuth, elevation, certainty = _direction(drive, ground)
    shines = separation >= LEAST_SEPARATION and certainty >= LEAST_CERTAINTY
    red, green, blue = np.round(np.clip(1 - ratio, 0, 0.95) * shines, 4).tolist()
    sun = Sun(azimuth, elevation, (red, green, blue))
    out = {**sun.to_json(), "certainty": round(certainty, 2), "separation": round(separation, 3)}
    if shines:
        out["ground"] = _sunlit(drive, sun, cells, brightness, heights).to_json()
    return out


def _heights(log: Log, lidars: tuple[str, ...], frames: tuple[int, ...]) -> HeightGrid | None:
    parts = []
    moving = [actor for actor in log.drive.actors.values() if actor.is_moving]
    for name in lidars:
        there = [frame for frame in log.sweep_frames(name) if frame in set(frames)]
        for i in spread_indices(len(there), SWEEPS):
            sweep = log.sweep(name, there[i])
            points, middle_s = sweep.points[::2], float(np.median(sweep.time_s))
            for actor in moving:
                if actor.present(middle_s):
                    pose = actor.world_from_actor.at(middle_s)
                    points = points[~points_in_box(points, pose, actor.size_m + 0.6)]
            parts.append(points)
    points = np.concatenate(parts) if parts else np.zeros((0, 3))
    ego = log.drive.world_from_ego.positions[:, :2]
    inside = ((points[:, :2] > ego.min(0) - 2 * NEAR_M) & (points[:, :2] < ego.max(0) + 2 * NEAR_M)).all(1)
    return height_grid(points[inside]) if inside.any() else None


def _ground_pixels(log: Log, cameras: tuple[str, ...], frames: tuple[int, ...], heights: HeightGrid) -> _Ground | None:
    parts = []
    for name in cameras:
        camera, there = log.drive.cameras[name], [f for f in log.image_frames(name) if f in set(frames)]
        step = max(1, camera.model.width // COLUMNS)
        u, v = np.meshgrid(np.arange(0, camera.model.width, step), np.arange(0, camera.model.height, step))
        for i in spread_indices(len(there), IMAGES):
            time_s = camera.time_s[there[i]]
            rays = camera_rays(camera, time_s, u + 0.5, v + 0.5).flat()
            down = np.flatnonzero(rays.directions[:, 2] < -0.04)  # NaN where a lens shows nothing
            origins, directions = rays.origins[down], rays.directions[down]
            points = origins + directions
            for _ in range(4):
                distance = (heights.at(points) - origins[:, 2]) / directions[:, 2]
                points = origins + directions * distance[:, None]
            place = np.round((points[:, :2] - heights.low) / 1.0).astype(np.int64)
            inside = ((place >= 0) & (place < heights.known.shape)).all(1) & (distance > 0) & (distance < NEAR_M)
            inside[inside] &= heights.known[tuple(place[inside].T)]
            for actor in log.drive.actors.values():
                if actor.present(time_s):
                    near, far = _span(actor.world_from_actor.at(time_s), actor.size_m + 0.2, origins, directions)
                    inside &= ~((near <= far) & (far > 0) & (near < distance))
            image = linear_from_srgb(
                log.image(name, there[i])[v, u].reshape(-1, 3)[down[inside]].astype(np.float32) / 255
            )
            colours = np.log(image.astype(np.float64) + BEFORE_BLACK)
            parts.append(_Ground(points[inside], colours, np.full(int(inside.sum()), time_s)))
    return _Ground(*map(np.concatenate, zip(*parts, strict=True))) if parts else None


def _span(
    pose: FloatArray, size_m: FloatArray, origins: FloatArray, directions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the distances (N,) at which rays, with directions (N, 3) or all with one, enter and leave a box; those that
    miss it leave before they enter."""
    local, along = (origins - pose[:3, 3]) @ pose[:3, :3], directions @ pose[:3, :3]
    inverse = 1 / np.where(np.abs(along) < 1e-12, 1e-12, along)
    a, b = (-size_m / 2 - local) * inverse, (size_m / 2 - local) * inverse
    return np.minimum(a, b).max(1), np.maximum(a, b).min(1)


def _quantile(values: FloatArray, which: NDArray[np.int64], count: int, part: float) -> FloatArray:
    """Return a quantile (count, K) of the values (N, K) of each group, by ``which`` (N,)."""
    sizes = np.bincount(which, minlength=count)
    middle = np.cumsum(sizes) - sizes + ((sizes - 1) * part).astype(np.int64)
    return np.stack([column[np.lexsort((column, which))][middle] for column in values.T], -1)


def _split(values: FloatArray) -> tuple[float, float]:
    """Return the threshold between two classes of values, and the part of their variance that the classes explain (Otsu
    1979)."""
    counts, edges = np.histogram(values, 80)
    centres, below = (edges[1:] + edges[:-1]) / 2, np.cumsum(counts) / counts.sum()
    means = np.cumsum(counts * centres) / counts.sum()
    between = (means[-1] * below[:-1] - means[:-1]) ** 2 / np.maximum(below[:-1] * (1 - below[:-1]), 1e-9)
    best = int(between.argmax())
    return float(edges[best + 1]), float(between[best] / max(np.var(values), 1e-12))


class _View(NamedTuple):
    """Ground beside a moving actor in one image: points (N, 3) in the actor's frame, how much brighter (N,) than at other
    times they are; the actor's size and rotation."""

    points: FloatArray
    brighter: FloatArray
    size_m: FloatArray
    rotation: FloatArray


def _direction(drive: Drive, ground: _Ground) -> tuple[float, float, float]:
    """Return azimuth and elevation of the sun, degrees, and the certainty of these."""
    _, which = np.unique(np.floor(ground.points[:, :2] / CELL_M).astype(np.int64), axis=0, return_inverse=True)
    which = which.reshape(-1)
    brightness, counts = ground.colours.mean(1), np.bincount(which)
    brighter = brightness - _quantile(brightness[:, None], which, len(counts), 0.6)[which, 0]
    often = counts[which] >= LEAST_IMAGES
    times, image = np.unique(ground.times_s, return_inverse=True)
    for number in range(len(times)):  # exposures differ
        mine = image == number
        if (mine & often).any():
            brighter[mine] -= np.median(brighter[mine & often])
    views = []
    for actor in drive.actors.values():
        for number, time_s in enumerate(times.tolist()):
            if actor.is_moving and actor.size_m[2] > 1 and actor.present(time_s):
                views += _views(actor, time_s, ground.points, np.clip(brighter, -1.5, 0.7), often & (image == number))
    scores = np.array([[_score(views, Sun(a, e, (0, 0, 0)).direction) for e in ELEVATIONS_DEG] for a in AZIMUTHS_DEG])
    known = np.isfinite(scores)
    if known.sum() < 0.2 * scores.size:
        return 0.0, 45.0, 0.0
    filled = np.where(known, scores, 0)
    rows = np.pad(np.concatenate([filled[-1:], filled, filled[:1]]), ((0, 0), (1, 1)), mode="edge")
    smooth = sum(
        weight * rows[1 + i : len(rows) - 1 + i, 1 + j : rows.shape[1] - 1 + j]
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        for weight in [0.25 / 2 ** (abs(i) + abs(j))]
    )
    best = np.unravel_index(np.argmax(smooth), smooth.shape)
    certainty = smooth[best] / max(float(smooth.std()), 1e-9)
    return float(AZIMUTHS_DEG[best[0]]), float(ELEVATIONS_DEG[best[1]]), float(certainty)


def _views(actor: Actor, time_s: float, points: FloatArray, brighter: FloatArray, some: BoolArray) -> list[_View]:
    pose = actor.world_from_actor.at(time_s)
    near = np.flatnonzero(some & (np.abs(points - pose[:3, 3]).max(1) < actor.size_m.max() / 2 + 6))
    if len(near) < 30:
        return []
    local = (points[near] - pose[:3, 3]) @ pose[:3, :3]
    return [_View(local, brighter[near], np.asarray(actor.size_m), pose[:3, :3])]


def _score(views: list[_View], direction: FloatArray) -> float:
    """Return the correlation of the darkness of ground with shadows of boxes; NaN where there are too few."""
    shadows, values = [np.zeros(0)], [np.zeros(0)]
    for view in views:
        near, far = _span(np.eye(4), 0.95 * view.size_m, view.points, direction @ view.rotation)
        shadows.append(((near < far) & (far > 0)).astype(np.float64))
        values.append(view.brighter)
    x, y = np.concatenate(shadows), np.concatenate(values)
    if x.sum() < LEAST_SHADOW_PIXELS:
        return np.nan
    x, y = x - x.mean(), y - y.mean()
    return -float(x @ y) / max(float(np.sqrt((x @ x) * (y @ y))), 1e-12)


def _sunlit(
    drive: Drive, sun: Sun, cells: NDArray[np.int64], brightness: FloatArray, heights: HeightGrid
) -> SunlitGround:
    """Return where the sun shone: what is nearer to the brightest ground's brightness than to that in the shade, but
    below and behind parked actors what is so beside."""
    low = cells.min(0)
    centres = (cells + 0.5) * GROUND_CELL_M
    points = np.concatenate([centres, heights.at(centres)[:, None]], 1)
    threshold, _ = _split(brightness)
    values = np.where(brightness >= threshold, 1.0, 0.0)
    for box in parked_boxes(drive).values():
        near, far = _span(box.world_from_box, box.size_m + 0.3, points, sun.direction)
        values[(near <= far) & (far > 0)] = np.nan
    grid = np.full((*(cells.max(0) - low + 1), 1), np.nan)
    grid[(*(cells - low).T, 0)] = values
    return SunlitGround(low * GROUND_CELL_M, GROUND_CELL_M, fill(grid)[..., 0] >= 0.5)
