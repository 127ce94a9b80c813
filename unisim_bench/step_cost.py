"""What a step of the closed loop costs, beside its image and its sweep rendered alone."""

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
from unisim_blender.core.scenario import FORMAT
from unisim_blender.core.scenario.simulation.document import OTHERS, SimulationSpec
from unisim_blender.core.sequence.plan import RenderPlan
from unisim_blender.core.simulation.clock import Exposure
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.rollout.opening import OpenedScenario, open_scenario
from unisim_blender.core.simulation.rollout.sensors import SimulatedSensors
from unisim_blender.core.simulation.step import step
from unisim_blender.core.simulation.vehicle.actions import Control
from unisim_blender.core.world.drive import Drive

BRAKING = Control(-1.0, 0.0)
"""What the vehicle does: it leaves its log, and so the actors drive by their models."""


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
