"""A simulation that is ready to run, and the `DriverSetup` of its driver."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...data.classes import Motion
from ...data.road import RoadCells
from ...geometry import FloatArray, invert_pose
from ...render.renderer import Renderer
from ...scenario.simulation import SimulationSpec
from ...scenario.types import Scenario
from ...scenes.scene import OpenScenes
from ...sequence.plan import RenderPlan
from ...world.captures import SECOND_US
from ...world.polyline import spaced
from ..drivers.driver import DriverKind
from ..edits import ScenarioDrive
from ..observations import DriverSetup, EgoMotion, SensorSetup
from ..step import SimulationContext, recorded_ego
from ..vehicle.ground import axle_height
from ..world import World


@contextmanager
def torch_in_one_thread() -> Iterator[None]:
    """Let torch, where it has been imported, use one thread. The compiled kernels, whose results do not depend on threads, keep
    theirs."""
    if "torch" not in sys.modules:
        yield
        return
    from ...ops.devices import torch_threads

    with torch_threads(1):
        yield


ROUTE_M = 1.0
"""Points of the route are so far apart."""
HISTORY_US = 2 * SECOND_US
BEYOND = 50
"""Number of route points beyond the recording's end, straight on."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """Inputs of a rollout: its ``stage``, the drive that it moves, how captures are rendered, and the world at the
    start. ``scenario`` is what it begins with."""

    scenario: Scenario
    spec: SimulationSpec
    stage: SimulationContext
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
        stage = self.stage
        sensors = {}
        drive = stage.drive
        mid_s = drive.time_s[drive.frames[len(drive.frames) // 2]]
        axle_from_world = invert_pose(drive.world_from_ego.at(mid_s) @ stage.vehicle.ego_from_axle)
        for name, camera in drive.cameras.items():
            model = camera.model if self.plan.settings.width is None else camera.resized(self.plan.settings.width).model
            sensors[name] = SensorSetup(model, axle_from_world @ camera.world_from_camera.at(mid_s))
        for name, lidar in drive.lidars.items():
            sensors[name] = SensorSetup(lidar.model, axle_from_world @ lidar.world_from_lidar.at(mid_s))
        recording = stage.recording if self.kind.privileged else None
        seed = self.spec.seed or 0
        height_m = axle_height(drive.world_from_ego.at(stage.start_us / SECOND_US), stage.vehicle, stage.heights)
        return DriverSetup(
            stage.vehicle,
            sensors,
            route_of(stage),
            stage.step_us,
            stage.delay_us,
            seed,
            height_m,
            self._history(),
            recording,
        )

    def _history(self) -> tuple[EgoMotion, ...]:
        """Return the recorded states before the start, where the vehicle starts as it was recorded."""
        stage = self.stage
        if self.begin.ego != recorded_ego(stage, stage.start_us):
            return ()
        first_us = round(stage.drive.time_s[stage.drive.frames[0]] * SECOND_US)
        back = min(stage.start_us - first_us, HISTORY_US) // stage.step_us
        times = [stage.start_us - k * stage.step_us for k in range(back, 0, -1)]
        return tuple(EgoMotion(time_us, recorded_ego(stage, time_us)) for time_us in times)


def route_of(stage: SimulationContext) -> FloatArray:
    """Return points (P, 2) along the recorded path of the rear axle, about `ROUTE_M` apart, carried on straight."""
    trajectory, axle = stage.drive.world_from_ego, np.array([*stage.vehicle.rear_axle_m, 1.0])
    places = (trajectory.poses @ axle)[:, :2]
    kept = places[spaced(places, ROUTE_M)]
    pose = trajectory.poses[-1]
    ahead = pose[:2, 0] / max(float(np.hypot(*pose[:2, 0])), 1e-9)
    end = kept[-1]
    return np.stack([*kept, *(end + ahead * ROUTE_M * k for k in range(1, BEYOND + 1))])
