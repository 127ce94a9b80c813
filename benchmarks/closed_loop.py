"""What a step of the closed loop costs before its frames are rendered, and how much memory a long rollout takes.

    python -m benchmarks.closed_loop sample/objects.json --actors 0 --actors 100
    python -m benchmarks.closed_loop sample/objects.json --memory 1000
    python -m benchmarks.closed_loop sample/objects.json --standing 20

Processor time: other processes change it less than what a clock on the wall shows.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from unisim_bench.state_cost import with_tracks
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.scenario.simulation import OTHER_ACTORS, SimulationSpec
from unisim_blender.core.scenario.time_range import Outside
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.rollout.sensors import SimulatedSensors
from unisim_blender.core.simulation.rollout.setup import OpenedScenario, Simulation, open_scenario
from unisim_blender.core.simulation.step import step
from unisim_blender.core.simulation.vehicle.actions import Control
from unisim_blender.core.world.drive import Drive

EXPOSED_US = 150_000
"""Exposures that end in a step have begun at most so long before its end."""


def with_actors(opened: OpenedScenario, count: int) -> OpenedScenario:
    """The scenario with copies of its moving actors, on tracks like theirs."""

    def more(drive: Drive) -> Drive:
        moving = {uid: one for uid, one in drive.actors.items() if one.is_moving and not one.is_ego_body}
        return replace(drive, actors={**drive.actors, **with_tracks(replace(drive, actors=moving), count).actors})

    return replace(opened, recorded=more(opened.recorded), edited=more(opened.edited)) if count else opened


def simulation(opened: OpenedScenario, model: str, duration_s: float | None = None) -> Simulation:
    """A simulation in which nothing is written."""
    asked = SimulationSpec(duration_s=duration_s, actors={OTHER_ACTORS: {"type": model}})
    return opened.simulation(asked, driver_named("constant"), Path(tempfile.gettempdir()))


def step_times(run: Simulation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Milliseconds of processor time of each step: of the world, and of the drive that is rendered."""
    world, rows = run.begin, []
    while world.time_us < run.context.stop_us:
        begun = time.process_time()
        world = step(world, Control(-1.0, 0.02), run.context)
        moved = time.process_time()
        run.scenario_drive.drive_at(world, world.time_us - EXPOSED_US)
        rows.append((moved - begun, time.process_time() - moved))
    world_ms, drive_ms = 1e3 * np.array(rows).T
    return world_ms, drive_ms


@dataclass(frozen=True)
class StandingCost:
    """Processor seconds of a sensor's frames while the vehicle stands, with parts kept and rendered whole, (N,) each, and
    the share of rays (N,) that were traced."""

    kept_s: NDArray[np.float64]
    whole_s: NDArray[np.float64]
    rays: NDArray[np.float64]


def standing_costs(run: Simulation, steps: int) -> dict[str, StandingCost]:
    """What frames cost while the vehicle stands, by the sensors' names. Every frame is rendered in both ways, by turns in
    either order. Raises AssertionError where their bytes differ."""
    both = SimulatedSensors(run.plan, run.renderer, None), SimulatedSensors(run.plan, run.renderer, None, reuse=None)
    world, rows = run.begin, dict[str, list[tuple[float, ...]]]()
    left = steps
    while left and world.time_us < run.context.stop_us:
        before, world = world, step(world, Control(-run.context.vehicle.max_deceleration_m_s2, 0.0), run.context)
        stands = before.ego.speed_m_s == 0
        left -= stands
        for one in run.context.ended(before.time_us, world.time_us):
            drive, name = run.scenario_drive.drive_at(world, one.start_us), one.capture.sensor_id
            spent, frames = [0.0, 0.0], []
            for way in (0, 1) if left % 2 else (1, 0):
                begun = time.process_time()
                delivered = both[way].render(drive, [one])
                spent[way] = time.process_time() - begun
                frames.append(delivered)
            (images, sweeps), (other_images, other_sweeps) = frames
            pairs = [(a.rgb.tobytes(), b.rgb.tobytes()) for a, b in zip(images, other_images, strict=True)]
            pairs += [(a.points.tobytes(), b.points.tobytes()) for a, b in zip(sweeps, other_sweeps, strict=True)]
            assert all(a == b for a, b in pairs), f"{name} differs at {world.time_us} us"
            share = both[0].frames[name].stats.rays / both[1].frames[name].stats.rays
            if stands:
                rows.setdefault(name, []).append((*spent, share))
    # the first is rendered whole
    return {name: StandingCost(*np.array(found[1:]).T) for name, found in rows.items()}


def resident_mb() -> float:
    """Megabytes that this process holds."""
    line = next(one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


@click.command()
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--actors", type=int, multiple=True, help="So many more of them.")
@click.option("--model", default="auto", show_default=True)
@click.option("--memory", type=int, default=0, help="Steps of a long simulation with images 32 pixels wide.")
@click.option(
    "--standing", type=int, default=0, help="Steps in which the vehicle stands, with images 640 wide and sweeps."
)
def main(scenario: Path, actors: tuple[int, ...], model: str, memory: int, standing: int) -> None:
    """Print what steps cost."""
    opened = open_scenario(scenario, RenderOptions(quality="fast", width=32, passes=("rgb",)))
    for count in actors:
        run = simulation(with_actors(opened, count), model)
        for kind, times in zip(("world", "drive"), step_times(run), strict=True):
            median, most = np.median(times), times.max()
            click.echo(f"{len(run.context.moved)} moved actors, {kind}: median {median:.1f} ms, most {most:.1f} ms")
    for quality in ("fast", "balanced") if standing else ():
        large = open_scenario(scenario, RenderOptions(quality=quality, width=640, passes=("rgb",)))
        large = replace(large, scenario=replace(large.scenario, outside=Outside("continue", "continue")))
        run = simulation(large, model, 3.0 + standing * 0.1)
        for name, cost in standing_costs(run, standing).items():
            kept_ms, whole_ms = 1e3 * np.median(cost.kept_s), 1e3 * np.median(cost.whole_s)
            click.echo(
                f"{quality}, {name}, {len(cost.rays)} frames: {kept_ms:.0f} ms, whole {whole_ms:.0f} ms, "
                f"ratio {np.median(cost.kept_s / cost.whole_s):.2f}, rays {np.median(cost.rays):.2f}"
            )
    if not memory:
        return
    opened = replace(opened, scenario=replace(opened.scenario, outside=Outside("continue", "continue")))
    run = simulation(opened, model, memory * 0.1)
    sensors, world, cameras = SimulatedSensors(run.plan, run.renderer, None), run.begin, run.context.drive.cameras
    for number in range(1, memory + 1):
        before, world = world, step(world, Control(0.0, 0.0), run.context)
        ended = [one for one in run.context.ended(before.time_us, world.time_us) if one.capture.sensor_id in cameras]
        if ended:
            sensors.render(run.scenario_drive.drive_at(world, min(one.start_us for one in ended)), ended)
        if number in (10, 50) or number % 100 == 0:
            click.echo(f"step {number}: {resident_mb():.1f} MB")


if __name__ == "__main__":
    main()
