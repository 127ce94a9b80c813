"""The ground that nobody saw, filled with what was seen of the same street.

The ground around a drive is a map of texels, whose rows go along the drive. A texel that some recorded image shows has the
colour that the trained scene gives it there; one that some sweep shows has its intensity. The others are filled from those
of their own rows, ahead and behind, and where these have none from those beside: lanes, kerbs and markings go on along a
street. The map is a property of the scene: all frames, cameras and LiDARs show the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..errors import OutputError
from ..files import read_arrays
from ..geometry import BoolArray, FloatArray, invert_pose, transform_points
from ..model.scene_file import SceneHeader
from ..sensors.frames import RenderStats
from ..sensors.rays import Rays, exposure_window
from ..world.drive import Camera, Lidar
from ..world.replay import DriveStates
from .observed_space import Observing, cache_file, store_in_cache
from .quality import QUALITIES
from .recorded_depth import shots, trace_recorded
from .tracer import Array

FILL_VERSION = 1
"""Version of the cached maps: to be raised when the same scene gives another map."""
TEXEL_M, MAX_TEXELS = 0.1, 2**22
"""Edge of a texel, metres, of which longer drives have larger ones; and the largest number of them."""
REACH_M = 45.0
"""Distance from a sensor, metres, up to which it shows texels."""
FILLED_M = 4.0
"""Distance from what was seen, metres, up to which the ground is filled."""
UNSURE_TEXELS, FEATHER_TEXELS = 2, 3
"""Texels beside those that were seen that are not filled, and over how many the filling grows from there."""
ON_SURFACE_M, PROBE_M = 0.3, 1.0
"""Largest distance of the scene's surface from a texel that it shows, and of the beginning of a ray to it, metres."""
COLOUR_PART = 0.8
"""Largest part of a colour that is replaced: the mean of two guesses is better than either."""
ALONG = 5
"""How often the map is halved along the drive, before it is halved in both directions."""
HEIGHT_M = 0.15
"""Height above the ground, metres, up to which a surface is ground."""


@dataclass(frozen=True)
class GroundFill:
    """Maps of the ground, (X, Y) texels of edge ``texel_m``, the first at the origin of the grid: ``colours`` (X, Y, 3) as the
    decoder gives them, and ``intensity`` (X, Y, 1). ``colour_share`` and ``intensity_share`` (X, Y, 1), 0 to 1: how much of
    each replaces what the scene has there."""

    grid_from_world: FloatArray
    texel_m: float
    colours: Array
    colour_share: Array
    intensity: Array
    intensity_share: Array

    def of_image(self, points: FloatArray, ground: BoolArray) -> tuple[Array, Array]:
        """Return colours (..., 3) and shares (..., 1) for what pixels show at points (..., 3), world frame, where that is
        ``ground`` (...)."""
        return self._at(self.colours, points), self._at(self.colour_share, points) * ground[..., None]

    def of_beams(self, points: FloatArray, ground: BoolArray) -> tuple[Array, Array]:
        """Return intensities (..., 1) and shares (..., 1) for beams that end at points (..., 3), world frame."""
        return self._at(self.intensity, points), self._at(self.intensity_share, points) * ground[..., None]

    def _at(self, values: Array, points: FloatArray) -> Array:
        """Return values (..., C) at points (..., 3), bilinear between texels; 0 outside of the map."""
        flat = transform_points(self.grid_from_world, points.reshape(-1, 3))[:, :2] / self.texel_m - 0.5
        limits = np.array(values.shape[:2]) - 1
        number = np.flatnonzero(((flat >= 0) & (flat <= limits)).all(1))
        low = np.minimum(flat[number].astype(np.int64), np.maximum(limits - 1, 0))
        u, v = (flat[number] - low).astype(np.float32).T[..., None]
        (i, j), (k, m) = low.T, np.minimum(low + 1, limits).T
        out = np.zeros((len(flat), values.shape[2]), np.float32)
        out[number] = (1 - u) * ((1 - v) * values[i, j] + v * values[i, m])
        out[number] += u * ((1 - v) * values[k, j] + v * values[k, m])
        return out.reshape(*points.shape[:-1], -1)


def trace_ground(backend: Observing) -> Iterator[float | GroundFill]:
    """Trace what the recorded images and sweeps show of the ground, and fill the rest: yield the fractions of work done, and last
    the result, which is cached among the user's files."""
    header = backend.observed[0]
    grid_from_world, shape, texel_m = _grid(header)
    file, arrays = None, {}
    with suppress(OSError):  # a scene that is not on disk has no cache
        file = cache_file(header, "ground", FILL_VERSION, type(backend).__name__, native.variant())
    with suppress(OutputError):
        arrays = {} if file is None else read_arrays(file, OutputError)
    if {name: values.shape for name, values in arrays.items()} != {
        "colours": (*shape, 3), "colour_share": (*shape, 1), "intensity": (*shape, 1), "intensity_share": (*shape, 1),
    }:  # fmt: skip
        for step in _traced(backend, header, grid_from_world, shape, texel_m):
            if isinstance(step, float):
                yield step
            else:
                arrays = {name: values.astype(np.float16) for name, values in step.items()}
        if file is not None:
            store_in_cache(file, arrays)
    yield GroundFill(grid_from_world, texel_m, **{name: np.asarray(x, np.float32) for name, x in arrays.items()})


def ground_fill(backend: Observing) -> GroundFill:
    """Return the result of `trace_ground`."""
    *_, result = trace_ground(backend)
    assert isinstance(result, GroundFill)
    return result


def _grid(header: SceneHeader) -> tuple[FloatArray, tuple[int, int], float]:
    """Return the pose of the map's grid, grid_from_world, its rows along the drive; its shape, and the edge of its texels in
    metres."""
    drive = header.drive
    path = drive.world_from_ego.at(np.array([drive.time_s[frame] for frame in drive.frames]))
    places = path[:, :2, 3]
    spread, axes = np.linalg.eigh(np.cov(places.T) if len(places) > 1 else np.zeros((2, 2)))
    along = axes[:, 1] if spread[1] > 1 else path[0, :2, 0]
    x, y = along / np.linalg.norm(along)
    turned = np.eye(4)
    turned[:2, :2] = [[x, y], [-y, x]]
    local = transform_points(turned, path[:, :3, 3])[:, :2]
    low, high = local.min(0) - REACH_M, local.max(0) + REACH_M
    turned[:2, 3] = -low
    texel_m = max(TEXEL_M, float(np.sqrt(np.prod(high - low) / MAX_TEXELS)))
    rows, columns = np.ceil((high - low) / texel_m).astype(int).tolist()
    return turned, (rows, columns), texel_m


def _traced(
    backend: Observing, header: SceneHeader, grid_from_world: FloatArray, shape: tuple[int, int], texel_m: float
) -> Iterator[float | dict[str, Array]]:
    """Yield the fractions of work done, and last the arrays of a `GroundFill`."""
    recorded = None
    for step in trace_recorded(backend, header):
        if isinstance(step, float):
            yield step / 2
        else:
            recorded = step
    assert recorded is not None
    states = DriveStates(header.drive, backend.parked)
    bare = states.state(*[header.drive.time_s[header.drive.frames[0]]] * 2).restricted([])
    row, column = np.meshgrid(*(np.arange(count) for count in shape), indexing="ij")
    texels = np.stack([(row + 0.5) * texel_m, (column + 0.5) * texel_m, np.zeros(shape)], -1).reshape(-1, 3)
    points = transform_points(invert_pose(grid_from_world), texels)
    points[:, 2] -= backend.bind(bare).heights(points)
    within = transform_points(invert_pose(np.asarray(header.volume["world_from_volume"], np.float64)), points)
    inside = ((within > 0) & (within < np.asarray(header.volume["size_m"]))).all(1)
    views = list(zip(shots(header), recorded.views, strict=True))
    nearest = {kind: np.full(len(points), np.inf, np.float32) for kind in (Camera, Lidar)}
    closest = {kind: np.full(len(points), -1, np.int32) for kind in (Camera, Lidar)}
    for number, ((sensor, _), view) in enumerate(views):
        yield 0.5 + 0.4 * number / len(views)
        to = points[:, :2] - view.world_from_view[:2, 3]
        some = np.flatnonzero(inside & ((to * to).sum(1) < REACH_M**2))
        shown, away = view.shows(points[some])
        better = shown & (away < nearest[type(sensor)][some])
        nearest[type(sensor)][some[better]] = away[better]
        closest[type(sensor)][some[better]] = number
    values = {Camera: np.zeros((len(points), 3), np.float32), Lidar: np.zeros((len(points), 1), np.float32)}
    known = {kind: np.zeros(len(points), bool) for kind in values}
    for number, ((sensor, time_s), view) in enumerate(views):
        yield 0.9 + 0.1 * number / len(views)
        some, is_image = np.flatnonzero(closest[type(sensor)] == number), isinstance(sensor, Camera)
        if not len(some):
            continue
        tracer = backend.bind(states.state(*exposure_window(sensor, time_s)).restricted([]))
        tracer.quality = QUALITIES["balanced"]
        to = points[some] - view.world_from_view[:3, 3]
        away = np.linalg.norm(to, axis=1, keepdims=True)
        directions, before = to / away, np.minimum(away, PROBE_M)
        rays = Rays(points[some] - directions * before, directions, np.full(len(some), time_s))
        traced = tracer.trace(rays, {"depth"}, is_image, None, RenderStats())
        known[type(sensor)][some] = np.abs(traced.maps["depth"] - before[:, 0]) < ON_SURFACE_M
        if is_image:
            image = tracer.image(traced, directions, sensor.sensor_id, (1, len(some)))
            values[Camera][some] = image[0, :: tracer.upsample]
        else:
            values[Lidar][some, 0] = tracer.returns(traced, directions)[0]
    out = {}
    for kind, name, share in ((Camera, "colours", "colour_share"), (Lidar, "intensity", "intensity_share")):
        source, seen = known[kind].reshape(shape), (closest[kind] >= 0).reshape(shape)
        out[name] = filled(values[kind].reshape(*shape, -1), source)
        out[share] = _share(source, seen, texel_m)
    out["colour_share"] *= np.float32(COLOUR_PART)
    yield out


def _share(known: BoolArray, seen: BoolArray, texel_m: float) -> Array:
    """Return how much of the map (X, Y, 1) is filled: texels that were not ``seen`` (X, Y), beside those that are ``known``."""
    wanted = (_around(known, round(FILLED_M / texel_m)) > 0) & (_around(seen, UNSURE_TEXELS) == 0)
    grown = _around(wanted, FEATHER_TEXELS // 2) / FEATHER_TEXELS**2
    return np.where(seen, 0, grown)[..., None].astype(np.float32)


def _around(marked: BoolArray, reach: int) -> NDArray[np.int64]:
    """Return how many of the texels within ``reach`` rows and columns of each are marked (X, Y)."""
    total = np.pad(marked.astype(np.int64), ((reach + 1, reach), (reach + 1, reach))).cumsum(0).cumsum(1)
    side = 2 * reach + 1
    return np.asarray(total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side])


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
