"""Costs of the closed loop: processor time of each step of a state of the world on the compiled path, before a ray is
traced; and a step of a simulation beside its image and its sweep rendered alone.

Drives get copies of an actor in a camera's view or behind it, or copies of all actors on tracks like theirs.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from unisim_blender.core.errors import SceneError
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.render.captures import render_capture
from unisim_blender.core.render.quality import Quality
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.compiled.tracer import CHUNK_RAYS
from unisim_blender.core.render.visibility import seen_by
from unisim_blender.core.scenario import FORMAT
from unisim_blender.core.scenario.simulation import OTHER_ACTORS, SimulationSpec
from unisim_blender.core.sensors.bounds import Bounds
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays, exposure_window
from unisim_blender.core.sequence.plan import RenderPlan
from unisim_blender.core.simulation.clock import Exposure
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.rollout.sensors import SimulatedSensors
from unisim_blender.core.simulation.rollout.setup import OpenedScenario, open_scenario
from unisim_blender.core.simulation.step import step
from unisim_blender.core.simulation.vehicle.actions import Control
from unisim_blender.core.world.drive import Actor, Camera, CameraModel, Drive, Lidar
from unisim_blender.core.world.replay import DriveStates

FIRST_M, ALONG_M, ACROSS_M = 8.0, 6.0, 3.0
"""Where the first row stands, and how far rows and columns are apart."""
WITHIN = 0.8
"""Share of half the field of view within which copies stand."""
WIDEST_DEG = 75.0
LABEL = "Car"
APART_M = 3.0
"""How far along x a copy's track is from the one of the copy before it."""


def copy_places(count: int, slope: float) -> FloatArray:
    """Places (count, 2) ahead and to the left, metres, the nearest row first and its middle first, within ``slope``
    metres to either side a metre ahead."""
    places: list[tuple[float, float]] = []
    ahead = FIRST_M
    while len(places) < count:
        columns = int(slope * ahead / ACROSS_M)
        places += [(ahead, ACROSS_M * column) for column in sorted(range(-columns, columns + 1), key=abs)]
        ahead += ALONG_M
    return np.array(places[:count], float).reshape(-1, 2)


def slope_aside(model: CameraModel) -> float:
    """How many metres to either side of the optical axis a camera sees a metre ahead, at most `WIDEST_DEG` from it: a fisheye
    sees beside itself, too."""
    if model.is_pinhole:
        return model.width / 2 / model.fx
    ends = model.unproject(np.linspace(0.5, model.width - 0.5, 129), np.full(129, model.height / 2))
    angle = np.arctan2(np.abs(ends[:, 0]), ends[:, 2])
    widest = float(angle[np.isfinite(angle)].max(initial=0.0))
    return float(np.tan(min(widest, np.radians(WIDEST_DEG))))


def model_actor(drive: Drive) -> Actor:
    """The actor that is copied: the car, or whatever there is, of the middle size. Raises `SceneError`."""
    actors = [actor for actor in drive.actors.values() if not actor.appearance.mesh]
    actors = [actor for actor in actors if actor.label == LABEL] or actors
    if not actors:
        raise SceneError(f"the drive {drive.name} has no actor that could be copied")
    return sorted(actors, key=lambda actor: (float(np.prod(actor.size_m)), actor.uid))[len(actors) // 2]


def with_copies(
    drive: Drive, heights: Callable[[FloatArray], FloatArray], view: str, frame: int, count: int, behind: bool
) -> Drive:
    """The drive with ``count`` copies on the ground, on a grid before the camera ``view`` at ``frame``, or ``behind``
    it as far. ``heights`` tells how high points (N, 3) are above the ground (N,)."""
    camera = drive.cameras[view]
    pose = camera.world_from_camera.at(camera.time_s[frame])
    yaw = float(np.arctan2(pose[1, 2], pose[0, 2]))
    places = copy_places(count, WITHIN * slope_aside(camera.model)) * (-1 if behind else 1)
    points = np.tile(pose[:3, 3], (count, 1))
    points[:, :2] += places @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    points[:, 2] -= heights(points)
    source = model_actor(drive)
    points[:, 2] += source.size_m[2] / 2
    first, last = drive.time_s[drive.frames[0]], drive.time_s[drive.frames[-1]]
    copies = {}
    for number, point in enumerate(points):
        uid = f"copy {number}"
        trajectory = Trajectory.from_poses(np.zeros(1), make_pose(point, quaternion_from_yaw(yaw))[None])
        copies[uid] = replace(
            source, uid=uid, world_from_actor=trajectory, start_s=first, end_s=last, is_moving=False, inserted=True
        )
    return replace(drive, actors={**drive.actors, **copies})


def with_tracks(drive: Drive, count: int) -> Drive:
    """The drive with ``count`` copies of its actors, one of each in turn, present throughout; each copy's track is that
    of its actor, shifted. Raises `SceneError` where there is no actor that could be copied."""
    sources = sorted(
        (actor for actor in drive.actors.values() if not actor.appearance.mesh), key=lambda actor: actor.uid
    )
    if count and not sources:
        raise SceneError(f"the drive {drive.name} has no actor that could be copied")
    first, last = drive.time_s[drive.frames[0]], drive.time_s[drive.frames[-1]]
    copies = {}
    for number in range(count):
        source = sources[number % len(sources)]
        track = source.world_from_actor
        shift = np.array([APART_M * (1 + number // len(sources)), 0.0, 0.0])
        shifted = Trajectory(track.times_s, track.positions + shift, track.quaternions_wxyz)
        uid = f"copy {number}"
        copies[uid] = replace(source, uid=uid, world_from_actor=shifted, start_s=first, end_s=last, inserted=True)
    return replace(drive, actors={**drive.actors, **copies})


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


def open_bench_scenario(
    scene: Path, log: Path | None, sensors: Sequence[str], width: int, device: str = "cpu"
) -> OpenedScenario:
    """Open a scene for simulations of its own drive, or of a log's. Raises `UnisimError`."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bench.json"
        # where there is no log, the drive is the scene's own
        name = str(Path(folder) / "none" if log is None else log.resolve())
        document = {"format": FORMAT, "version": 1, "name": "bench", "log": name, "edits": []}
        document["scene"] = str(scene.resolve())
        file.write_text(json.dumps(document))
        return open_scenario(file, RenderOptions(sensors=tuple(sensors), width=width, device=device, passes=("rgb",)))


def step_cost(opened: OpenedScenario, quality: Quality, most_steps: int) -> StepCost | None:
    """Measure a simulation's first steps, ``most_steps`` at most; nothing is written. None where no step delivers one frame of
    each sensor. Raises `UnisimError`."""
    opened.renderer.quality = quality
    asked = SimulationSpec(actors={OTHER_ACTORS: {"type": "auto"}})
    run = opened.simulation(asked, driver_named("constant"), Path(tempfile.gettempdir()))
    context, world = run.context, run.begin
    sensors = SimulatedSensors(run.plan, run.renderer, None)
    rows: list[tuple[float, float, float]] = []
    while world.time_us < context.stop_us and len(rows) <= most_steps:
        begun, spent, before = time.perf_counter(), time.process_time(), world
        world = step(world, BRAKING, context)
        ended = context.ended(before.time_us, world.time_us)
        drive = run.scenario_drive.drive_at(world, min((exposure.start_us for exposure in ended), default=None))
        spent = time.process_time() - spent
        sensors.render(drive, ended)
        whole = time.perf_counter() - begun
        if sorted(exposure.capture.sensor_id for exposure in ended) == sorted(opened.sensors):
            alone = _alone(run.renderer, run.plan, drive, ended)
            rows.append((whole, alone, spent))
    some = rows[1:] or rows  # the first is slower than those after it
    if not some:
        return None
    step_s, alone_s, world_s = np.median(np.array(some), axis=0).tolist()
    return StepCost(step_s, alone_s, world_s, len(context.moved), len(some))


def _alone(renderer: Renderer, plan: RenderPlan, drive: Drive, exposures: Sequence[Exposure]) -> float:
    states, settings = plan.captures.of_drive(drive), plan.settings
    begun = time.perf_counter()
    for exposure in exposures:
        render_capture(renderer, states, exposure.capture, width=settings.width, draw=settings.draw)
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
