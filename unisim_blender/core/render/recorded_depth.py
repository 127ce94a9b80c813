"""The images and sweeps that a scene was trained on, traced for their distances, from which confidence is computed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..model.scene_file import SceneHeader
from ..sensors.camera import camera_rays, pixel_grid
from ..sensors.frames import RenderStats
from ..sensors.rays import Rays, exposure_window
from ..world.drive import Camera, Lidar
from ..world.replay import DriveStates
from .confidence import FAR_M, UNMEASURED, DepthView, RecordedDepth, around
from .observed_space import cached_arrays, store_in_cache
from .quality import QUALITIES
from .tracer import Array, Backend

VIEWS_PER_SENSOR = 24
"""Largest number of frames of each sensor that points are projected into."""
IMAGE_COLUMNS, SWEEP_COLUMNS, SWEEP_ROWS = 240, 720, 64
"""Rays across an image, around a sweep and from its lowest to its highest beam."""


def trace_recorded(backend: Backend, header: SceneHeader) -> Iterator[float | RecordedDepth]:
    """Trace the images and sweeps that a scene was trained on: yield the fractions of work done, and last the result, which is
    cached among the user's files."""
    captures = list(shots(header))
    file, stored = cached_arrays(header, "depth", VIEWS_PER_SENSOR, IMAGE_COLUMNS, SWEEP_COLUMNS, SWEEP_ROWS)
    states, views = DriveStates(header.drive, backend.parked), []
    rows = {uid: row for row, uid in enumerate(sorted(header.drive.actors), 1)}
    for number, (sensor, time_s) in enumerate(captures):
        yield number / len(captures)
        view, rays = empty_view(sensor, time_s)
        shape = rays.time_s.shape
        depth, actor = stored.get(f"depth{number}"), stored.get(f"actor{number}")
        if depth is None or actor is None or not depth.shape == actor.shape == shape:
            state = states.state(*exposure_window(sensor, time_s))
            tracer = backend.bind(state.restricted([actor.uid for actor in state.actors if not actor.appearance.scene]))
            tracer.quality = QUALITIES["fast"]
            traced = tracer.trace(rays, {"depth", "instance"}, isinstance(sensor, Camera), None, RenderStats())
            depth = np.minimum(traced.maps["depth"], FAR_M).astype(np.float32)
            if isinstance(sensor, Lidar):
                # a beam that does not return says nothing about its way
                returns = tracer.returns(traced, rays.flat().directions)[1] >= 0.5
                depth = np.where(returns & (depth <= sensor.model.max_range_m), depth, 0).astype(np.float32)
            table = np.array([0, *(rows.get(uid, 0) for uid in tracer.active.uids)], np.int16)
            depth, actor = depth.reshape(shape), table[traced.maps["instance"]].reshape(shape)
            stored |= {f"depth{number}": depth, f"actor{number}": actor}
            if file is not None and number == len(captures) - 1:
                store_in_cache(file, stored)
        near, far = around(depth)
        views.append(replace(view, nearest=near, farthest=far, actor=np.asarray(actor, np.int16)))
    measured = header.training.get("accuracy", {})
    image, sweep = (float(measured.get(kind, UNMEASURED)) for kind in ("camera", "lidar"))
    yield RecordedDepth(tuple(views), header.drive.actors, (image, sweep))


def recorded_depth(backend: Backend, header: SceneHeader) -> RecordedDepth:
    """Return the result of `trace_recorded`."""
    *_, result = trace_recorded(backend, header)
    assert isinstance(result, RecordedDepth)
    return result


def shots(header: SceneHeader) -> Iterator[tuple[Camera | Lidar, float]]:
    """Yield sensors and times of the frames that a scene was trained on, `VIEWS_PER_SENSOR` at most of each."""
    drive, training = header.drive, header.training
    trained = set(training.get("frames", ())) & set(drive.frames) or set(drive.frames)
    for kind, sensors in (("cameras", drive.cameras), ("lidars", drive.lidars)):
        for name in training.get(kind, ()):
            sensor = sensors.get(name)
            if sensor is None or (isinstance(sensor, Lidar) and not sensor.model.beams):
                continue
            frames = sorted(trained & set(sensor.time_s))
            for frame in frames[:: -(-len(frames) // VIEWS_PER_SENSOR) or 1]:
                yield sensor, sensor.time_s[frame]


def empty_view(sensor: Camera | Lidar, time_s: float) -> tuple[DepthView, Rays]:
    """Return a sensor's view without distances, and the rays (h, w) that these are traced along."""
    none: tuple[Array, Array, NDArray[np.int16]] = (np.empty((0, 0), np.float32),) * 2 + (np.empty((0, 0), np.int16),)
    pose = sensor.trajectory.at(time_s)
    if isinstance(sensor, Camera):
        small = sensor.resized(min(IMAGE_COLUMNS, sensor.model.width))
        rays = camera_rays(small, time_s, *pixel_grid(small.model))
        return DepthView(time_s, pose, small.model, 0.0, 0.0, *none, sensor.sensor_id), rays
    low, high = float(sensor.model.elevation_rad.min()), float(sensor.model.elevation_rad.max())
    row_rad = max((high - low) / (SWEEP_ROWS - 1), 1e-4)
    elevation = low + row_rad * np.arange(SWEEP_ROWS)[:, None]
    azimuth = ((np.arange(SWEEP_COLUMNS) + 0.5) / SWEEP_COLUMNS - 0.5)[None] * 2 * np.pi
    level = np.cos(elevation)
    local = np.stack(np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)), -1)
    origins = np.broadcast_to(pose[:3, 3], local.shape).copy()
    rays = Rays(origins, local @ pose[:3, :3].T, np.full(local.shape[:2], time_s))
    return DepthView(time_s, pose, None, low, row_rad, *none), rays
