"""Costs of the closed loop: a state of the world on the compiled path before a ray is traced, processor time of each step; and a
step of a simulation beside its image and its sweep rendered alone."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.render.captures import render_capture
from unisim_blender.core.render.quality import Quality
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.compiled.tracer import CHUNK_RAYS
from unisim_blender.core.render.visibility import seen_by
from unisim_blender.core.scenario import FORMAT
from unisim_blender.core.scenario.simulation import OTHERS, SimulationSpec
from unisim_blender.core.sensors.bounds import Bounds
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays, exposure_window
from unisim_blender.core.sequence.plan import RenderPlan
from unisim_blender.core.simulation.clock import Exposure
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.rollout.opening import OpenedScenario, open_scenario
from unisim_blender.core.simulation.rollout.sensors import SimulatedSensors
from unisim_blender.core.simulation.step import step
from unisim_blender.core.simulation.vehicle.actions import Control
from unisim_blender.core.world.drive import Camera, Drive, Lidar
from unisim_blender.core.world.replay import DriveStates

from .copies import with_tracks

BRAKING = Control(-1.0, 0.0)
"""Control of the vehicle: with it, the vehicle leaves its log, and so the actors drive by their models."""


@dataclass(frozen=True)
class StepCost:
    """Medians over ``steps`` steps that delivered one frame of each sensor: seconds of a step and of its frames rendered alone,
    one after the other, and processor seconds of what comes before rendering, the vehicle, ``actors`` and the drive."""

    step_s: float
    alone_s: float
    world_s: float
    actors: int
    steps: int


def open_scene(scene: Path, log: Path | None, sensors: Sequence[str], width: int) -> OpenedScenario:
    """Open a scene for simulations of its own drive, or of a log's. Raises `UnisimError`."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bench.json"
        # where there is no log, the drive is the scene's own
        name = str(Path(folder) / "none" if log is None else log.resolve())
        document = {
            "format": FORMAT,
            "version": 1,
            "name": "bench",
            "log": name,
            "scene": str(scene.resolve()),
            "edits": [],
        }
        file.write_text(json.dumps(document))
        return open_scenario(file, RenderOptions(sensors=tuple(sensors), width=width, passes=("rgb",)))


def step_cost(opened: OpenedScenario, quality: Quality, most_steps: int) -> StepCost | None:
    """Measure a simulation's first steps, ``most_steps`` at most; nothing is written. None where no step delivers one frame of
    each sensor. Raises `UnisimError`."""
    opened.renderer.quality = quality
    asked = SimulationSpec(actors={OTHERS: {"type": "auto"}})
    run = opened.simulation(asked, driver_named("constant"), Path(tempfile.gettempdir()))
    stage, world = run.stage, run.begin
    sensors = SimulatedSensors(run.plan, run.renderer, None)
    rows: list[tuple[float, float, float]] = []
    while world.time_us < stage.stop_us and len(rows) <= most_steps:
        begun, spent, before = time.perf_counter(), time.process_time(), world
        world = step(world, BRAKING, stage)
        ended = stage.ended(before.time_us, world.time_us)
        drive = run.scenario_drive.drive_at(world, min((one.start_us for one in ended), default=None))
        spent = time.process_time() - spent
        sensors.render(drive, ended)
        whole = time.perf_counter() - begun
        if sorted(one.capture.sensor_id for one in ended) == sorted(opened.sensors):
            alone = _alone(run.renderer, run.plan, drive, ended)
            rows.append((whole, alone, spent))
    some = rows[1:] or rows  # the first is slower than those after it
    if not some:
        return None
    step_s, alone_s, world_s = np.median(np.array(some), axis=0).tolist()
    return StepCost(step_s, alone_s, world_s, len(stage.moved), len(some))


def _alone(renderer: Renderer, plan: RenderPlan, drive: Drive, exposures: Sequence[Exposure]) -> float:
    states, settings = plan.captures.of_drive(drive), plan.settings
    begun = time.perf_counter()
    for one in exposures:
        render_capture(renderer, states, one.capture, width=settings.width, draw=settings.draw)
    return time.perf_counter() - begun


STEPS = ("state", "digest", "visibility", "bind", "culling")
"""In their order: `DriveStates.state`, `WorldState.digest`, `visibility.seen_by`, `Backend.bind`, and `Bounds.in_reach`
for the rays that the tracer takes at a time."""


@dataclass(frozen=True)
class AddedActors:
    """Number of ``actors`` in the state, and number of ``repeats`` of every step."""

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
