"""How a simulation begins: the scenario that its folder holds, with all that the simulation decides, the context of its steps,
and the ego vehicle's start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import ScenarioError
from ...geometry import FloatArray, Trajectory
from ...render.captures import CaptureStates
from ...render.renderer import Renderer
from ...scenario import rebased
from ...scenario.edit import Edit
from ...scenario.edits.retime import Retime
from ...scenario.sensors.document import CameraSpec, LidarSpec, Sensors
from ...scenario.simulation import OTHER_ACTORS, SimulationSpec
from ...scenario.time_range import Outside
from ...scenario.times import ego_outside, recording_us
from ...scenario.types import Outputs, Scenario
from ...world.captures import US_PER_SECOND, microseconds
from ...world.classes import Motion, motion_of
from ...world.drive import Drive
from ..actors.model import ActorModel, model_from_dict
from ..actors.models.auto import Auto
from ..actors.models.replay import Replay
from ..actors.recording import Recording
from ..clock import Exposure, Rate, exposures, recorded_rate
from ..drivers.driver import DriverKind
from ..states import EgoState
from ..step import SimulationContext, recorded_ego
from ..vehicle.ground import Heights, VehicleGround
from ..vehicle.parameters import Vehicle, poses_of
from ..world import jumps
from .steps import BASE_NAME

STEP_S = 0.1


def context_of(
    drive: Drive,
    place: str,
    spec: SimulationSpec,
    kind: DriverKind,
    heights: Heights,
    classes: Mapping[str, Motion] | None,
    start_us: int,
    stop_us: int,
) -> SimulationContext:
    """Return where a scenario is simulated, between two times. Raises `ScenarioError` and `SimulationError`, which name the
    member below ``place``, "FILE: simulation"."""
    vehicle = Vehicle.from_dict(spec.vehicle or {}, f"{place}.vehicle")
    models = _models(drive, spec, place)
    rates = {name: recorded_rate(sensor) for name, sensor in drive.sensors.items()}
    for name, own in (spec.rates or {}).items():
        if name not in rates:
            raise ScenarioError(f"{place}.rates.{name}: is not one of {', '.join(rates)}")
        was = rates[name]
        rates[name] = Rate(
            was.period_us if own.period_s is None else microseconds(own.period_s),
            was.phase_us if own.phase_s is None else microseconds(own.phase_s),
        )
    within = _within(drive, rates, start_us, stop_us, place)
    ahead = vehicle.rear_axle_m[0] + vehicle.length_m / 2 - vehicle.rear_overhang_m
    recording = Recording.of(
        _known_from(drive, start_us / US_PER_SECOND), lambda label: motion_of(label, classes), spec.seed or 0, ahead
    )
    recording.prepare(models)
    passive = not kind.drives and all(isinstance(model, Replay | Auto) for model in models.values())
    ground = VehicleGround(drive.world_from_ego, vehicle, heights)

    def on_ground(states: Sequence[EgoState]) -> FloatArray:
        return poses_of(states, ground.attitudes(states), vehicle)

    return SimulationContext(
        drive,
        recording,
        vehicle,
        on_ground,
        heights,
        models,
        frozenset() if passive else frozenset(models),
        within,
        start_us,
        stop_us,
        microseconds(spec.step_s or STEP_S),
        microseconds(spec.delay_s or 0.0),
    )


def _within(drive: Drive, rates: Mapping[str, Rate], start_us: int, stop_us: int, place: str) -> tuple[Exposure, ...]:
    """Return the exposures of a simulation. Raises `ScenarioError` where there are sensors, and it is too short for any."""
    complete = tuple(exposures(drive, rates, start_us, stop_us))
    if complete or not rates:
        return complete
    late_us = stop_us + 2 * max(rate.period_us for rate in rates.values()) + 2 * US_PER_SECOND
    first_us = exposures(drive, rates, start_us, late_us)[0].end_us
    raise ScenarioError(
        f"{place}: from {start_us / US_PER_SECOND:g} to {stop_us / US_PER_SECOND:g} s no exposure of {', '.join(rates)} is "
        f"complete: the first ends at {first_us / US_PER_SECOND:g} s"
    )


def span_us(drive: Drive, scenario: Scenario, spec: SimulationSpec, kind: DriverKind) -> tuple[int, int]:
    """Return from when to when a simulation lasts, microseconds. Raises `ScenarioError` for times outside the recording, but for
    those after it where the scenario says what the ego vehicle does there and the driver follows no log."""
    first_us, last_us = recording_us(drive)
    span = f"the recording, {first_us / US_PER_SECOND:g} … {last_us / US_PER_SECOND:g} s"
    place = f"{scenario.path}: simulation"
    start_us = first_us if spec.start_s is None else microseconds(spec.start_s)
    stop_us = last_us if spec.duration_s is None else start_us + microseconds(spec.duration_s)
    if not first_us <= start_us < last_us:
        raise ScenarioError(
            f"{place}.start_s: {start_us / US_PER_SECOND:g} s must lie within {span}, and before its end"
        )
    if stop_us == start_us:
        raise ScenarioError(f"{place}.duration_s: {spec.duration_s:g} s is less than a microsecond")
    if stop_us > last_us and not (kind.drives and ego_outside(scenario) is not None):
        asked = f"{start_us / US_PER_SECOND:g} to {stop_us / US_PER_SECOND:g} s"
        raise ScenarioError(f"{place}: {asked} must lie within {span}")
    return start_us, stop_us


def _known_from(drive: Drive, start_s: float) -> Drive:
    """Return a drive as models of actors know it in a simulation that starts at ``start_s``: what jumps there has neither a path
    nor a speed from before."""
    actors = {
        uid: replace(
            actor, world_from_actor=_from(actor.world_from_actor, start_s), start_s=max(actor.start_s, start_s)
        )
        if jumps(actor.world_from_actor, start_s)
        else actor
        for uid, actor in drive.actors.items()
    }
    ego = drive.world_from_ego
    return replace(drive, world_from_ego=_from(ego, start_s) if jumps(ego, start_s) else ego, actors=actors)


def _from(trajectory: Trajectory, start_s: float) -> Trajectory:
    """Return a trajectory with a first key at ``start_s``, and the keys behind it to the bit."""
    after = trajectory.times_s > start_s
    position, quaternion = trajectory.placed_at(start_s)
    return Trajectory(
        np.concatenate([[start_s], trajectory.times_s[after]]),
        np.concatenate([position[None], trajectory.positions[after]]),
        np.concatenate([quaternion[None], trajectory.quaternions_wxyz[after]]),
    )


def heights_at(renderer: Renderer, captures: CaptureStates, time_us: int) -> Heights:
    """Return what tells how high points are above the scene's ground."""
    time_s = time_us / US_PER_SECOND
    return renderer.tracer(captures.states.state(time_s, time_s)).heights


def _models(drive: Drive, spec: SimulationSpec, place: str) -> dict[str, ActorModel]:
    """Return the models of moving actors, by identifier."""
    own = spec.actors or {}
    for uid in own:
        if uid != OTHER_ACTORS and uid not in drive.actors:
            raise ScenarioError(f"{place}.actors.{uid}: there is no such actor")
    models: dict[str, ActorModel] = {}
    for uid, actor in sorted(drive.actors.items()):
        if actor.is_ego_body or (not actor.is_moving and uid not in own):
            continue
        document = own.get(uid, own.get(OTHER_ACTORS, {"type": "replay"}))
        models[uid] = model_from_dict(document, f"{place}.actors.{uid if uid in own else OTHER_ACTORS}")
    return models


def drawn_ego(context: SimulationContext, spec: SimulationSpec) -> EgoState | None:
    """Return where the ego vehicle starts; None for where it was recorded."""
    jitter = spec.jitter
    limits = () if jitter is None else (
        jitter.ego_along_m, jitter.ego_aside_m, jitter.ego_yaw_deg, jitter.ego_speed_m_s,
    )  # fmt: skip
    if not any(limits):
        return None
    draws = generator(spec.seed or 0, "ego").uniform(-1.0, 1.0, 4)
    along, aside, yaw, speed = (float(draw) * (limit or 0.0) for draw, limit in zip(draws, limits, strict=True))
    ego = recorded_ego(context, context.start_us)
    c, s = math.cos(ego.heading_rad), math.sin(ego.heading_rad)
    return replace(
        ego,
        x_m=ego.x_m + along * c - aside * s,
        y_m=ego.y_m + along * s + aside * c,
        heading_rad=ego.heading_rad + math.radians(yaw),
        speed_m_s=max(ego.speed_m_s + speed, 0.0),
    )


def base_scenario(
    scenario: Scenario, drive: Drive, spec: SimulationSpec, sensors: tuple[str, ...], outputs: Outputs, out: Path
) -> Scenario:
    """Return the scenario that is simulated, in folder ``out``; ``drive`` is that of ``scenario``.

    Its sensors are those named, it has no frames or times, actors start as ``spec.jitter`` draws it, and the vehicle goes on
    outside the recording.
    """
    moved = drawn_starts(drive, spec)
    base = rebased(scenario, out / BASE_NAME)
    outside = scenario.outside or Outside("absent", "continue")
    return replace(
        base,
        frames=None,
        times=None,
        outside=outside,
        sensors=_listed(scenario.sensors, drive, sensors),
        edits=(*base.edits, *moved),
        outputs=outputs,
        simulation=spec,
    )


def drawn_starts(drive: Drive, spec: SimulationSpec) -> list[Edit]:
    """Return the edits by which moving actors start earlier or later, drawn by the seed and each actor's id."""
    most = (spec.jitter.actors_s if spec.jitter else None) or 0.0
    if not most:
        return []
    return [
        Retime(actor=uid, offset_s=round(float(generator(spec.seed or 0, uid).uniform(-most, most)), 6))
        for uid, actor in sorted(drive.actors.items())
        if actor.is_moving and not actor.is_ego_body
    ]


def generator(seed: int, uid: str) -> np.random.Generator:
    """Return the random generator of a start, from the simulation's seed and what starts."""
    return np.random.default_rng([seed, len(uid), *uid.encode()])


def _listed(sensors: Sensors | None, drive: Drive, wanted: tuple[str, ...]) -> Sensors:
    stated = (sensors or Sensors()).with_times(lambda spec: None)
    cameras = {spec.id: spec for spec in stated.cameras or ()}
    lidars = {spec.id: spec for spec in stated.lidars or ()}
    return Sensors(
        tuple(cameras.get(name) or CameraSpec(name) for name in drive.cameras if name in wanted),
        tuple(lidars.get(name) or LidarSpec(name) for name in drive.lidars if name in wanted),
    )
