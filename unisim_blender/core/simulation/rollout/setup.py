"""Scenarios opened for simulation, simulations that are ready to run, and the `DriverSetup` of their drivers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...actor_images.lamps import lamps_in
from ...data.log import Log, extras_of
from ...data.road import RoadCells, road_cells
from ...errors import OutputError, refused
from ...formats.readers import open_log
from ...geometry import FloatArray, invert_pose
from ...prepare.scenario import log_of_scene
from ...prepare.scenario_plan import RenderOptions, plan_scenario
from ...render.renderer import Renderer
from ...scenario import load_scenario, save_scenario, scenario_from_json, scenario_to_json
from ...scenario.context import EditContext
from ...scenario.simulation import SimulationSpec
from ...scenario.types import FRAME_FORMATS, Outputs, Scenario
from ...scenes.scene import OpenScenes
from ...sequence.plan import RenderPlan
from ...world.captures import US_PER_SECOND
from ...world.classes import Motion
from ...world.drive import Drive
from ...world.lamps import ActorLamp
from ...world.polyline import spaced
from ..drivers.driver import DriverKind, DriverSetup, EgoMotion, SensorSetup
from ..edits import ScenarioDrive, without_driven
from ..step import SimulationContext, recorded_ego, start
from ..vehicle.ground import axle_height
from ..world import World
from .staging import base_scenario, context_of, drawn_ego, heights_at, span_us
from .steps import BASE_NAME


@contextmanager
def single_threaded_torch() -> Iterator[None]:
    """Let torch, where it has been imported, use one thread. The compiled kernels, whose results do not depend on threads, keep
    theirs."""
    if "torch" not in sys.modules:
        yield
        return
    from ...ops.devices import torch_threads

    with torch_threads(1):
        yield


ROUTE_M = 1.0
"""Spacing of the route's points."""
HISTORY_US = 2 * US_PER_SECOND
BEYOND = 50
"""Number of route points beyond the recording's end, straight on."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """Inputs of a rollout: its ``context``, the drive that it moves, how captures are rendered, and the world at the
    start. ``scenario`` is what it begins with."""

    scenario: Scenario
    spec: SimulationSpec
    context: SimulationContext
    scenario_drive: ScenarioDrive
    plan: RenderPlan
    renderer: Renderer
    begin: World
    kind: DriverKind
    out: Path
    classes: Mapping[str, Motion] | None = None
    """How actors of the log's own classes move."""
    scenes: OpenScenes | None = None
    """Trained scenes that are open."""
    road: Callable[[], RoadCells | None] = lambda: None
    """Gives the road by the log's labels, None where it has none. Raises `LogError`."""

    def setup(self) -> DriverSetup:
        """Return what a driver is told before it drives."""
        context = self.context
        sensors = {}
        drive = context.drive
        mid_s = drive.time_s[drive.frames[len(drive.frames) // 2]]
        axle_from_world = invert_pose(drive.world_from_ego.at(mid_s) @ context.vehicle.ego_from_axle)
        for name, camera in drive.cameras.items():
            model = camera.model if self.plan.settings.width is None else camera.resized(self.plan.settings.width).model
            sensors[name] = SensorSetup(model, axle_from_world @ camera.trajectory.at(mid_s))
        for name, lidar in drive.lidars.items():
            sensors[name] = SensorSetup(lidar.model, axle_from_world @ lidar.world_from_lidar.at(mid_s))
        recording = context.recording if self.kind.privileged else None
        seed = self.spec.seed or 0
        height_m = axle_height(
            drive.world_from_ego.at(context.start_us / US_PER_SECOND), context.vehicle, context.heights
        )
        return DriverSetup(
            context.vehicle,
            sensors,
            route_of(context),
            context.step_us,
            context.delay_us,
            seed,
            height_m,
            self._history(),
            recording,
        )

    def _history(self) -> tuple[EgoMotion, ...]:
        """Return the recorded states before the start, where the vehicle starts as it was recorded."""
        context = self.context
        if self.begin.ego != recorded_ego(context, context.start_us):
            return ()
        first_us = round(context.drive.time_s[context.drive.frames[0]] * US_PER_SECOND)
        back = min(context.start_us - first_us, HISTORY_US) // context.step_us
        times = [context.start_us - k * context.step_us for k in range(back, 0, -1)]
        return tuple(EgoMotion(time_us, recorded_ego(context, time_us)) for time_us in times)


def route_of(context: SimulationContext) -> FloatArray:
    """Return points (P, 2) along the recorded path of the rear axle, about `ROUTE_M` apart, carried on straight."""
    trajectory, axle = context.drive.world_from_ego, np.array([*context.vehicle.rear_axle_m, 1.0])
    places = (trajectory.poses @ axle)[:, :2]
    points = places[spaced(places, ROUTE_M)]
    pose = trajectory.poses[-1]
    ahead = pose[:2, 0] / max(float(np.hypot(*pose[:2, 0])), 1e-9)
    end = points[-1]
    return np.stack([*points, *(end + ahead * ROUTE_M * k for k in range(1, BEYOND + 1))])


@dataclass(frozen=True, eq=False)
class OpenedScenario:
    """A scenario, opened for simulations of it: its drives before and after its edits, and what renders it.

    ``sensors`` are simulated; ``log`` is None where it is not there. ``scenes`` has opened all that it is rendered with.
    """

    scenario: Scenario
    recorded: Drive
    edited: Drive
    sensors: tuple[str, ...]
    outputs: Outputs
    plan: RenderPlan
    renderer: Renderer
    log: Log | None
    scenes: OpenScenes

    @property
    def classes(self) -> Mapping[str, Motion] | None:
        """How actors of the log's own classes move."""
        return None if self.log is None else extras_of(self.log).classes

    @cached_property
    def road(self) -> RoadCells | None:
        """The road by the log's labels; None where it has none. It is read when it is asked for. Raises `LogError`."""
        return None if self.log is None else road_cells(self.log)

    def _lamps(self) -> Mapping[str, tuple[ActorLamp, ...]]:
        """Return the lamps that the log's images show in two states. Raises `LogError`."""
        return {} if self.log is None else lamps_in(self.log)

    @single_threaded_torch()
    def simulation(self, asked: SimulationSpec, kind: DriverKind, out: Path) -> Simulation:
        """Return a simulation whose results go to folder ``out``. Members of ``asked`` that are not None go before the scenario's
        own. Raises `ScenarioError` and `SimulationError`."""
        spec = merged(self.scenario, asked)
        idle = {*self.edited.cameras, *self.edited.lidars}.difference(self.sensors)
        spec = replace(
            spec, rates={name: rate for name, rate in (spec.rates or {}).items() if name not in idle} or None
        )
        base = base_scenario(self.scenario, self.edited, spec, self.sensors, self.outputs, out)
        start_us, stop_us = span_us(self.edited, self.scenario, spec, kind)
        reads = EditContext(base, self.recorded, self.scenes.actors, self._lamps)
        scenario_drive = ScenarioDrive.of(base, reads, start_us, stop_us)
        drive = scenario_drive.drive()
        rest = replace(base, edits=without_driven(base.edits))
        if kind.drives and rest.edits != base.edits:
            scenario_drive = ScenarioDrive.of(rest, replace(reads, scenario=rest), start_us, stop_us)
        place = f"{self.scenario.path}: simulation"
        heights = heights_at(self.renderer, self.plan.captures, start_us)
        context = context_of(drive, place, spec, kind, heights, self.classes, start_us, stop_us)
        begin = start(context, kind.drives, drawn_ego(context, spec) if kind.drives else None)
        plan = replace(self.plan, drive=drive)
        return Simulation(
            base, spec, context, scenario_drive, plan, self.renderer, begin, kind, out, self.classes, self.scenes,
            lambda: self.road,
        )  # fmt: skip


LoadRenderer = Callable[[RenderPlan], Renderer]


def new_renderer(plan: RenderPlan) -> Renderer:
    """Return a plan's renderer, loaded for it. Raises `UnisimError`."""
    return plan.recipe.load()


def open_scenario(
    source: Path | str | Scenario, options: RenderOptions, load: LoadRenderer = new_renderer
) -> OpenedScenario:
    """Open a scenario, or a log alone, for simulations. ``source`` is its path or URL, or the scenario. Raises `UnisimError`."""
    plan, prepared = plan_scenario(source, replace(options, frames=None, times=None))
    own = prepared.scenario.outputs or Outputs()
    if options.passes is None and own.passes is None:
        plan = replace(plan, settings=replace(plan.settings, passes=("rgb", "unsupported")))
    outputs = Outputs(
        passes=plan.settings.passes,
        formats=own.formats or ("png", "npz", "labels"),
        width=plan.settings.width,
        quality=plan.settings.quality,
        contact_shadows=own.contact_shadows,
        fill=plan.settings.fill if plan.settings.fill != "none" else None,
        detail=plan.settings.detail or None,
    )
    formats = tuple(name for name in FRAME_FORMATS if name in (outputs.formats or ()))
    plan = replace(plan, settings=replace(plan.settings, formats=formats))
    log, path, scene = None, prepared.log_path, prepared.scene
    if path.exists():
        log = open_log(path) if scene is None else log_of_scene(scene, path)
    sensors = (*plan.settings.cameras, *plan.settings.lidars)
    drives = prepared.recorded, prepared.edited
    return OpenedScenario(prepared.scenario, *drives, sensors, outputs, plan, load(plan), log, prepared.scenes)


def open_simulation(
    source: Path | str | Scenario,
    out: Path,
    options: RenderOptions,
    asked: SimulationSpec,
    kind: DriverKind,
    resume: bool = False,
    load: LoadRenderer = new_renderer,
) -> Simulation:
    """Open the simulation of a scenario, or of a log alone, and note it in folder ``out``; see `OpenedScenario.simulation`.

    Raises `UnisimError`; `OutputError` where ``out`` is not empty and ``resume`` is not set, or holds something else.
    """
    simulation = open_scenario(source, options, load).simulation(asked, kind, out)
    note_scenario(simulation.scenario, out, resume)
    return simulation


def merged(scenario: Scenario, asked: SimulationSpec) -> SimulationSpec:
    """Return a scenario's simulation with what is asked for in its place. Raises `ScenarioError` where a document could not say
    that."""
    given = {name: value for name, value in vars(asked).items() if value is not None}
    spec = replace(scenario.simulation or SimulationSpec(), **given)
    alone = Scenario(name="simulation", log="log", simulation=spec)
    scenario_from_json(scenario_to_json(alone), scenario.path)
    return spec


def note_scenario(scenario: Scenario, out: Path, resume: bool) -> None:
    """Write the scenario that is simulated into folder ``out``, or check that it is the one of the rollout that is resumed.
    Raises `OutputError`."""
    path = out / BASE_NAME
    if resume and path.exists():
        if scenario_to_json(load_scenario(path)) != scenario_to_json(scenario):
            raise OutputError(f"{path}: is the rollout of another scenario or of other options; name another folder")
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out}: is not empty; name another folder, or continue the rollout it holds with --resume")
    with refused(out, "made", OutputError):
        out.mkdir(parents=True, exist_ok=True)
    save_scenario(scenario, path)
