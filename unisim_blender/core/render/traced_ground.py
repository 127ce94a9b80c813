"""The map of the ground of a trained scene, traced from what was recorded of it, filled and cached."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .. import native
from ..geometry import FloatArray, invert_pose, transform_points
from ..model.scene_file import SceneHeader
from ..sensors.frames import RenderStats
from ..sensors.rays import Rays, exposure_window
from ..world.drive import Camera, Lidar
from ..world.replay import DriveStates
from .ground_fill import (
    COLOUR_PART,
    FILL_VERSION,
    MAX_TEXELS,
    ON_SURFACE_M,
    PROBE_M,
    REACH_M,
    TEXEL_M,
    GroundFill,
    filled,
    share_of,
)
from .observed_space import Observing, cached_arrays, store_in_cache
from .quality import QUALITIES
from .recorded_depth import shots, trace_recorded
from .tracer import Array


def trace_ground(backend: Observing) -> Iterator[float | GroundFill]:
    """Trace what the recorded images and sweeps show of the ground, and fill the rest: yield the fractions of work done, and last
    the result, which is cached among the user's files."""
    header = backend.observed[0]
    grid_from_world, shape, texel_m = _grid(header)
    file, arrays = cached_arrays(header, "ground", FILL_VERSION, type(backend).__name__, native.variant())
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
        out[share] = share_of(source, seen, texel_m)
    out["colour_share"] *= np.float32(COLOUR_PART)
    yield out
