"""What a state of the world costs on the compiled path, before a ray is traced: processor time of each step."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.compiled.tracer import CHUNK_RAYS
from unisim_blender.core.render.visibility import seen_by
from unisim_blender.core.sensors.bounds import Bounds
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.exposure import exposure_window
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Camera, Drive, Lidar
from unisim_blender.core.world.replay import DriveStates

from .copies import with_tracks

STEPS = ("state", "digest", "visibility", "bind", "culling")
"""In their order: `DriveStates.state`, `WorldState.digest`, `visibility.seen_by`, `Backend.bind`, and `Bounds.in_reach`
for the rays that the tracer takes at a time."""


@dataclass(frozen=True)
class AddedActors:
    """So many ``actors`` in the state; every step is repeated so many times."""

    actors: int
    repeats: int


@dataclass(frozen=True)
class StateCost:
    """``steps_s`` are medians of processor seconds by the names in `STEPS`. Of the ``actors`` in the state, ``seen``
    are left by the test of visibility and ``in_reach`` by the culling; ``keys`` are the most that one has in the drive.
    All of them are bound and held against the rays: the cost where the sensor sees all of them."""

    steps_s: dict[str, float]
    actors: int
    keys: int
    seen: int
    in_reach: int
    rays: int


def state_cost(renderer: Renderer, drive: Drive, sensor: Camera | Lidar, frame: int, added: AddedActors) -> StateCost:
    """Measure what the state of a frame costs with copies of the drive's actors among its own. Raises `SceneError`."""
    backend, time_s = renderer.backend, sensor.time_s[frame]
    window = exposure_window(sensor, time_s)
    there = len(DriveStates(drive, backend.parked).state(*window).actors)
    drive = with_tracks(drive, max(0, added.actors - there))
    states = DriveStates(drive, backend.parked)
    state = states.state(*window)
    bounds, parts = Bounds(state.actors), _chunks(_rays(sensor, time_s))
    rows, in_reach, seen = [], set[int](), state
    for _ in range(added.repeats + 1):
        clock = [time.process_time()]
        state = states.state(*window)
        clock.append(time.process_time())
        _ = state.digest
        clock.append(time.process_time())
        seen = seen_by(state, sensor, renderer.reach)
        clock.append(time.process_time())
        backend.bind(state)
        clock.append(time.process_time())
        in_reach = {actor for rays in parts for actor in bounds.in_reach(rays)}
        clock.append(time.process_time())
        rows.append(np.diff(clock))
    # the first is slower than those after it
    medians = np.median(rows[1:], axis=0).tolist()
    keys = max((len(drive.actors[actor.uid].world_from_actor.times_s) for actor in state.actors), default=0)
    return StateCost(
        dict(zip(STEPS, medians, strict=True)),
        len(state.actors), keys, len(seen.actors), len(in_reach), sum(len(rays.time_s) for rays in parts),
    )  # fmt: skip


def _rays(sensor: Camera | Lidar, time_s: float) -> Rays:
    """Return the flat rays of every pixel or beam."""
    rays = (
        lidar_rays(sensor, time_s)
        if isinstance(sensor, Lidar)
        else camera_rays(sensor, time_s, *pixel_grid(sensor.model))
    )
    return rays.flat().sound()


def _chunks(rays: Rays) -> list[Rays]:
    parts = [slice(begin, begin + CHUNK_RAYS) for begin in range(0, len(rays.time_s), CHUNK_RAYS)]
    return [Rays(rays.origins[part], rays.directions[part], rays.time_s[part]) for part in parts]
