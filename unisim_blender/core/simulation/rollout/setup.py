"""A simulation of a scenario, opened: its stage, what renders it, and where its results go."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...data import open_log
from ...data.classes import Motion, motion_of
from ...data.log import extras_of
from ...errors import OutputError, ScenarioError, UnisimError
from ...geometry import FloatArray, invert_pose
from ...prepare.scenario import prepare_scenario, scene_actors
from ...prepare.scenario_plan import RenderOptions, plan_scenario
from ...prepare.selection import check_names
from ...render.drive_renderer import DriveRenderer
from ...scenario import load_scenario, save_scenario, scenario_to_json
from ...scenario.context import Context
from ...scenario.simulation.document import OTHERS, SimulationSpec
from ...scenario.times.ranges import recording_us
from ...scenario.types import Outputs, Scenario
from ...sequence.plan import RenderPlan
from ...world.captures import SECOND_US, microseconds
from ...world.drive import Camera, Drive, Lidar
from ..actors.model import ActorModel, model_from_dict
from ..actors.models.auto import Auto
from ..actors.models.replay import Replay
from ..actors.recording import Recording
from ..clock import Rate, exposures, recorded_rate
from ..drivers.driver import DriverKind
from ..edits import Course
from ..observations import Mounted, Setup
from ..stage import Stage
from ..states import EgoState
from ..step import recorded_ego, start
from ..vehicle.ground import Ground, Heights
from ..vehicle.parameters import Vehicle, pose_of
from ..world import World
from .base import BASE_NAME, base_scenario, generator

STEP_S = 0.1
ROUTE_M = 1.0
"""Points of the route are so far apart."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """What a rollout needs: its ``stage`` and ``course``, the ``plan`` and ``renderer`` of its captures, and the world at the
    start. ``scenario`` is what it begins with."""

    scenario: Scenario
    spec: SimulationSpec
    stage: Stage
    course: Course
    plan: RenderPlan
    renderer: DriveRenderer
    begin: World
    kind: DriverKind
    out: Path
    classes: Mapping[str, Motion] | None = None
    """How actors of the log's own classes move."""

    def setup(self) -> Setup:
        """Return what a driver is told before it drives."""
        stage = self.stage
        sensors = {}
        drive = stage.drive
        mid_s = drive.time_s[drive.frames[len(drive.frames) // 2]]
        rear_axle = np.eye(4)
        rear_axle[:3, 3] = stage.vehicle.rear_axle_m
        world_from_axle = drive.world_from_ego.at(mid_s) @ rear_axle
        for name, camera in drive.cameras.items():
            model = camera.model if self.plan.settings.width is None else camera.resized(self.plan.settings.width).model
            sensors[name] = Mounted(model, invert_pose(world_from_axle) @ camera.world_from_camera.at(mid_s))
        for name, lidar in drive.lidars.items():
            sensors[name] = Mounted(lidar.model, invert_pose(world_from_axle) @ lidar.world_from_lidar.at(mid_s))
        recording = stage.recording if self.kind.privileged else None
        seed = self.spec.seed or 0
        return Setup(stage.vehicle, sensors, route_of(stage), stage.step_us, stage.delay_us, seed, recording)


def route_of(stage: Stage) -> FloatArray:
    """Return points (P, 2) along the recorded path of the rear axle, about `ROUTE_M` apart, carried on straight by 50 m."""
    trajectory, axle = stage.drive.world_from_ego, np.array([*stage.vehicle.rear_axle_m, 1.0])
    places = (trajectory.poses @ axle)[:, :2]
    kept = [places[0]]
    for place in places[1:]:
        if np.hypot(*(place - kept[-1])) >= ROUTE_M:
            kept.append(place)
    pose = trajectory.poses[-1]
    ahead = pose[:2, 0] / max(float(np.hypot(*pose[:2, 0])), 1e-9)
    end = kept[-1]
    return np.stack([*kept, *(end + ahead * ROUTE_M * k for k in range(1, 51))])


def open_simulation(
    path: Path, out: Path, options: RenderOptions, asked: SimulationSpec, kind: DriverKind, resume: bool = False
) -> Simulation:
    """Open what is to be simulated of a scenario, or of a log alone, and note it in folder ``out``.

    Members of ``asked`` that are not None go before the scenario's own. Raises `UnisimError`, `OutputError` where ``out`` is not
    empty and ``resume`` is not set, or holds a rollout of something else.
    """
    prepared = prepare_scenario(path, scene=options.scene)
    spec = merged(prepared.scenario.simulation or SimulationSpec(), asked)
    drive = prepared.edited
    there = (*drive.cameras, *(name for name, lidar in drive.lidars.items() if lidar.model.beams))
    sensors = there if options.sensors is None else options.sensors
    check_names("sensor", sensors, there)
    own = prepared.scenario.outputs or Outputs()
    outputs = Outputs(
        passes=options.passes or own.passes or ("rgb", "unsupported"),
        formats=own.formats or ("png", "npz", "labels"),
        width=options.width or own.width,
        quality=options.quality or own.quality,
        contact_shadows=own.contact_shadows,
    )
    scenario = base_scenario(prepared.scenario, drive, spec, sensors, outputs, out)
    if options.scene is not None:
        scenario = replace(scenario, scene=str(options.scene.resolve()))
    _note(scenario, out, resume)
    plan, opened = plan_scenario(scenario.path, replace(options, frames=None, times=None, sensors=None, scene=None))
    renderer = plan.make_renderer()
    if not isinstance(renderer, DriveRenderer):
        raise UnisimError(f"--renderer {plan.settings.renderer}: cannot render a drive that changes")
    course = Course.of(opened.scenario, Context(opened.scenario, opened.recorded, scene_actors))
    log = open_log(opened.scenario.log_path) if opened.scenario.log_path.exists() else None
    classes = None if log is None else extras_of(log).classes
    stage = _stage(course.drive(), opened.scenario, spec, kind, renderer, classes)
    begin = start(stage, kind.drives, _drawn_ego(stage, spec) if kind.drives else None)
    return Simulation(opened.scenario, spec, stage, course, plan, renderer, begin, kind, out, classes)


def merged(own: SimulationSpec, asked: SimulationSpec) -> SimulationSpec:
    """Return a scenario's simulation with what is asked for in its place."""
    given = {name: value for name, value in vars(asked).items() if value is not None}
    return replace(own, **given)


def _note(scenario: Scenario, out: Path, resume: bool) -> None:
    """Write the scenario that is simulated, or check that it is the one of the rollout that is resumed."""
    path = out / BASE_NAME
    if resume and path.exists():
        if scenario_to_json(load_scenario(path)) != scenario_to_json(scenario):
            raise OutputError(f"{path}: is the rollout of another scenario or of other options; name another folder")
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out}: is not empty; name another folder, or continue the rollout it holds with --resume")
    out.mkdir(parents=True, exist_ok=True)
    save_scenario(scenario, path)


def _stage(
    drive: Drive,
    scenario: Scenario,
    spec: SimulationSpec,
    kind: DriverKind,
    renderer: DriveRenderer,
    classes: Mapping[str, Motion] | None,
) -> Stage:
    place = f"{scenario.path}: simulation"
    first_us, last_us = recording_us(drive)
    start_us = first_us if spec.start_s is None else microseconds(spec.start_s)
    stop_us = last_us if spec.duration_s is None else start_us + microseconds(spec.duration_s)
    if not first_us <= start_us < stop_us <= last_us:
        span = f"{first_us / SECOND_US:g} … {last_us / SECOND_US:g} s"
        raise ScenarioError(
            f"{place}: {start_us / SECOND_US:g} to {stop_us / SECOND_US:g} s must lie within the recording, {span}"
        )
    vehicle = Vehicle.from_dict(spec.vehicle or {}, f"{place}.vehicle")
    models = _models(drive, spec, place)
    sensors: dict[str, Camera | Lidar] = {**drive.cameras, **drive.lidars}
    rates = {name: recorded_rate(one) for name, one in sensors.items()}
    for name, own in (spec.rates or {}).items():
        if name not in rates:
            raise ScenarioError(f"{place}.rates.{name}: is not one of {', '.join(rates)}")
        was = rates[name]
        rates[name] = Rate(
            was.period_us if own.period_s is None else microseconds(own.period_s),
            was.phase_us if own.phase_s is None else microseconds(own.phase_s),
        )
    ahead = vehicle.rear_axle_m[0] + vehicle.length_m / 2 - vehicle.rear_overhang_m
    recording = Recording.of(drive, lambda label: motion_of(label, classes), spec.seed or 0, ahead)
    passive = not kind.drives and all(isinstance(model, Replay | Auto) for model in models.values())
    heights = _heights(renderer, start_us)
    ground = Ground(drive.world_from_ego, vehicle, heights)

    def poses_of(states: Sequence[EgoState]) -> list[FloatArray]:
        attitudes = ground.attitudes(states)
        return [pose_of(state, attitude, vehicle) for state, attitude in zip(states, attitudes, strict=True)]

    return Stage(
        drive,
        recording,
        vehicle,
        poses_of,
        heights,
        models,
        frozenset() if passive else frozenset(models),
        tuple(exposures(drive, rates, start_us, stop_us)),
        start_us,
        stop_us,
        microseconds(spec.step_s or STEP_S),
        microseconds(spec.delay_s or 0.0),
    )


def _heights(renderer: DriveRenderer, time_us: int) -> Heights:
    """Return what tells how high points are above the scene's ground."""
    time_s = time_us / SECOND_US
    return renderer.renderer.tracer(renderer.states.state(time_s, time_s)).heights


def _models(drive: Drive, spec: SimulationSpec, place: str) -> dict[str, ActorModel]:
    """Return the models of moving actors, by identifier."""
    own = spec.actors or {}
    for uid in own:
        if uid != OTHERS and uid not in drive.actors:
            raise ScenarioError(f"{place}.actors.{uid}: there is no such actor")
    models: dict[str, ActorModel] = {}
    for uid, actor in sorted(drive.actors.items()):
        if actor.is_ego_body or (not actor.is_moving and uid not in own):
            continue
        document = own.get(uid, own.get(OTHERS, {"type": "replay"}))
        models[uid] = model_from_dict(document, f"{place}.actors.{uid if uid in own else OTHERS}")
    return models


def _drawn_ego(stage: Stage, spec: SimulationSpec) -> EgoState | None:
    """Return where the ego vehicle starts; None for where it was recorded."""
    jitter = spec.jitter
    limits = () if jitter is None else (
        jitter.ego_along_m, jitter.ego_aside_m, jitter.ego_yaw_deg, jitter.ego_speed_m_s,
    )  # fmt: skip
    if not any(limits):
        return None
    draws = generator(spec.seed or 0, "ego").uniform(-1.0, 1.0, 4)
    along, aside, yaw, speed = (float(draw) * (limit or 0.0) for draw, limit in zip(draws, limits, strict=True))
    ego = recorded_ego(stage, stage.start_us)
    c, s = math.cos(ego.heading_rad), math.sin(ego.heading_rad)
    return replace(
        ego,
        x_m=ego.x_m + along * c - aside * s,
        y_m=ego.y_m + along * s + aside * c,
        heading_rad=ego.heading_rad + math.radians(yaw),
        speed_m_s=max(ego.speed_m_s + speed, 0.0),
    )
