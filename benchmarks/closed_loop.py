"""What a step of the closed loop costs before its frames are rendered, and how much memory a long rollout takes.

    python -m benchmarks.closed_loop sample/objects.json --actors 0 --actors 100
    python -m benchmarks.closed_loop sample/objects.json --memory 1000

Processor time: other processes hardly change it.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from unisim_blender.core.bench.copies import with_tracks
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.scenario.simulation.document import OTHERS, SimulationSpec
from unisim_blender.core.scenario.times.document import Outside
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.rollout.opening import Opened, open_scenario
from unisim_blender.core.simulation.rollout.sensors import SimulatedSensors
from unisim_blender.core.simulation.rollout.setup import Simulation
from unisim_blender.core.simulation.step import step
from unisim_blender.core.simulation.vehicle.actions import Control
from unisim_blender.core.world.drive import Drive


def with_actors(opened: Opened, count: int) -> Opened:
    """The scenario with copies of its moving actors, on tracks like theirs."""

    def more(drive: Drive) -> Drive:
        moving = {uid: one for uid, one in drive.actors.items() if one.is_moving and not one.is_ego_body}
        return replace(drive, actors={**drive.actors, **with_tracks(replace(drive, actors=moving), count).actors})

    return replace(opened, recorded=more(opened.recorded), edited=more(opened.edited)) if count else opened


def simulation(opened: Opened, model: str, duration_s: float | None = None) -> Simulation:
    """A simulation in which nothing is written."""
    asked = SimulationSpec(duration_s=duration_s, actors={OTHERS: {"type": model}})
    return opened.simulation(asked, driver_named("constant"), Path(tempfile.gettempdir()))


def step_times(run: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Milliseconds of processor time of each step: of the world, and of the drive that is rendered."""
    world, rows = run.begin, []
    while world.time_us < run.stage.stop_us:
        begun = time.process_time()
        world = step(world, Control(-1.0, 0.02), run.stage)
        moved = time.process_time()
        run.scenario_drive.drive_at(world)
        rows.append((moved - begun, time.process_time() - moved))
    world_ms, drive_ms = 1e3 * np.array(rows).T
    return world_ms, drive_ms


def resident_mb() -> float:
    """Megabytes that this process holds."""
    line = next(one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


@click.command()
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--actors", type=int, multiple=True, help="So many more of them.")
@click.option("--model", default="auto", show_default=True)
@click.option("--memory", type=int, default=0, help="Steps of a long simulation with images 32 pixels wide.")
def main(scenario: Path, actors: tuple[int, ...], model: str, memory: int) -> None:
    """Print what steps cost."""
    opened = open_scenario(scenario, RenderOptions(quality="fast", width=32, passes=("rgb",)))
    for count in actors:
        run = simulation(with_actors(opened, count), model)
        for kind, times in zip(("world", "drive"), step_times(run), strict=True):
            median, most = np.median(times), times.max()
            click.echo(f"{len(run.stage.moved)} moved actors, {kind}: median {median:.1f} ms, most {most:.1f} ms")
    if not memory:
        return
    opened = replace(opened, scenario=replace(opened.scenario, outside=Outside("continue", "continue")))
    run = simulation(opened, model, memory * 0.1)
    sensors, world, cameras = SimulatedSensors(run.plan, run.renderer, None), run.begin, run.stage.drive.cameras
    for number in range(1, memory + 1):
        before, world = world, step(world, Control(0.0, 0.0), run.stage)
        ended = [one for one in run.stage.ended(before.time_us, world.time_us) if one.capture.sensor_id in cameras]
        sensors.render(run.scenario_drive.drive_at(world), ended)
        if number in (10, 50) or number % 100 == 0:
            click.echo(f"step {number}: {resident_mb():.1f} MB")


if __name__ == "__main__":
    main()
