"""The maps of the ground and of the façades of a trained scene, traced from what was recorded of it, filled and cached."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..geometry import FloatArray, invert_pose, transform_points
from ..model.scene_file import SceneHeader
from ..sensors.frames import RenderStats
from ..sensors.rays import Rays, exposure_window
from ..world.drive import Camera, Lidar
from ..world.replay import DriveStates
from .facades import fitted_facades, surfaces_of
from .observed_space import Observing, cached_arrays, store_in_cache
from .plane_fill import (
    COLOUR_PART,
    FACADE_M,
    FILL_VERSION,
    MAX_TEXELS,
    ON_SURFACE_M,
    PROBE_M,
    REACH_M,
    TEXEL_M,
    PlaneFill,
    SensorKind,
    Texture,
    TexturedPlane,
    filled,
    share_of,
)
from .quality import QUALITIES
from .recorded_depth import empty_view, shots, trace_recorded
from .tracer import NEAR_M, Tracer

NAMES: dict[SensorKind, str] = {Camera: "colours", Lidar: "intensity"}


def trace_planes(backend: Observing) -> Iterator[float | PlaneFill]:
    """Trace what the recorded images and sweeps show of the ground and of façades, and fill the rest: yield the fractions of work
    done, and last the result, which is cached among the user's files."""
    header = backend.observed[0]
    file, arrays = cached_arrays(header, "ground", FILL_VERSION, type(backend).__name__, native.variant())
    if "grids" not in arrays:
        for step in _traced(backend, header):
            if isinstance(step, float):
                yield step
            else:
                arrays = step
        if file is not None:
            store_in_cache(file, arrays)
    arrays = {name: x.astype(np.float32) if x.dtype == np.float16 else x for name, x in arrays.items()}
    planes = []
    for number, (grid, texel_m) in enumerate(zip(arrays["grids"], arrays["texels_m"].tolist(), strict=True)):
        textures = {
            kind: Texture(arrays[f"{name}{number}"], arrays[f"{name}_share{number}"])
            for kind, name in NAMES.items()
            if f"{name}{number}" in arrays
        }
        planes.append(TexturedPlane(grid, texel_m, arrays.get(f"relief{number}"), textures))
    yield PlaneFill(tuple(planes))


def plane_fill(backend: Observing) -> PlaneFill:
    """Return the result of `trace_planes`."""
    *_, result = trace_planes(backend)
    assert isinstance(result, PlaneFill)
    return result


def _grid(header: SceneHeader) -> tuple[FloatArray, tuple[int, int], float]:
    """Return the pose of the ground's grid, grid_from_world, its rows along the drive; its shape, and the edge of its texels in
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


def _traced(backend: Observing, header: SceneHeader) -> Iterator[float | dict[str, NDArray[Any]]]:
    """Yield the fractions of work done, and last the arrays of a `PlaneFill`."""
    recorded = None
    for step in trace_recorded(backend, header):
        if isinstance(step, float):
            yield step / 2
        else:
            recorded = step
    assert recorded is not None
    states = DriveStates(header.drive, backend.parked)
    views = list(zip(shots(header), recorded.views, strict=True))
    facades = fitted_facades([surfaces_of(view, empty_view(*shot)[1]) for shot, view in views])
    grids = [_grid(header)]
    for grid, size_m in facades:
        rows, columns = np.ceil(size_m / TEXEL_M).astype(int).tolist()
        grids.append((grid, (rows, columns), TEXEL_M))
    begin_s = header.drive.time_s[header.drive.frames[0]]
    tracer = backend.bind(states.state(begin_s, begin_s).restricted([]))
    tracer.quality = QUALITIES["balanced"]
    points = np.concatenate([_places(tracer, header, begin_s, *grid) for grid in grids])
    within = transform_points(invert_pose(np.asarray(header.volume["world_from_volume"], np.float64)), points)
    inside = ((within > 0) & (within < np.asarray(header.volume["size_m"]))).all(1)
    nearest = {kind: np.full(len(points), np.inf, np.float32) for kind in (Camera, Lidar)}
    closest = {kind: np.full(len(points), -1, np.int32) for kind in (Camera, Lidar)}
    # a façade's own intensities are no worse than filled ones: sweeps show the ground's texels alone
    asked = {Camera: inside, Lidar: inside & (np.arange(len(points)) < np.prod(grids[0][1]))}
    for number, ((sensor, _), view) in enumerate(views):
        yield 0.5 + 0.4 * number / len(views)
        to = points[:, :2] - view.world_from_view[:2, 3]
        some = np.flatnonzero(asked[type(sensor)] & ((to * to).sum(1) < REACH_M**2))
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
    out: dict[str, NDArray[Any]] = {"grids": np.array([each[0] for each in grids])}
    out["texels_m"] = np.array([each[2] for each in grids])
    first = 0
    for number, (grid, shape, texel_m) in enumerate(grids):
        mine = slice(first, first := first + shape[0] * shape[1])
        if number > 0:
            out[f"relief{number}"] = transform_points(grid, points[mine])[:, 2].reshape(*shape, 1).astype(np.float16)
        for kind, name in NAMES.items() if number == 0 else [(Camera, NAMES[Camera])]:
            source, seen = (x[mine].reshape(shape) for x in (known[kind], (closest[kind] >= 0) | ~inside))
            share = share_of(source, seen, texel_m) * np.float32(COLOUR_PART if kind is Camera else 1)
            out[f"{name}{number}"] = filled(values[kind][mine].reshape(*shape, -1), source).astype(np.float16)
            out[f"{name}_share{number}"] = share.astype(np.float16)
    yield out


def _places(
    tracer: Tracer[Any], header: SceneHeader, time_s: float, grid: FloatArray, shape: tuple[int, int], texel_m: float
) -> FloatArray:
    """Return the places (X Y, 3) of a grid's texels, world frame: on the ground, or on the scene's surface that is seen from the
    side of the drive, and on the plane where none is near."""
    row, column = np.meshgrid(*(np.arange(count) for count in shape), indexing="ij")
    texels = np.stack([(row + 0.5) * texel_m, (column + 0.5) * texel_m, np.zeros(shape)], -1).reshape(-1, 3)
    points = transform_points(invert_pose(grid), texels)
    if grid[2, 2] == 1:
        points[:, 2] -= tracer.heights(points)
        return points
    path = transform_points(grid, header.drive.world_from_ego.positions)
    off: FloatArray = grid[2, :3] * (1.0 if np.median(path[:, 2]) > 0 else -1.0)
    starts, toward = points + FACADE_M * off, np.broadcast_to(-off, points.shape).copy()
    depth = tracer.trace(
        Rays(starts, toward, np.full(len(points), time_s)), {"depth"}, False, None, RenderStats()
    ).maps["depth"]
    near = (depth > NEAR_M) & (depth < 2 * FACADE_M)
    return starts + toward * np.where(near, depth, FACADE_M)[:, None].astype(np.float64)
