"""A rollout from a scenario to its scores, and many of them in processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...errors import OutputError
from ...executors import EXECUTORS
from ...executors.executor import ProcessLost, results_of
from ...files import hold_folder, write_file
from ...json_file import json_bytes
from ...prepare.scenario_plan import RenderOptions, plan_scenario
from ...processes import single_threaded
from ...scenario import save_scenario
from ...scenario.simulation import SimulationSpec
from ...scenario.time_range import Outside
from ...scenario.times import actors_outside
from ...scenario.types import Scenario
from ...sequence.run import RenderReport, render_sequence
from ...world.captures import US_PER_SECOND
from ..drivers import Endpoint, driver_named
from ..edits import edits_of
from ..world import World, recorded_keys
from .loop import Rollout, roll_out
from .score import SCORES_NAME, scores_of
from .setup import OpenedScenario, Simulation, note_scenario, open_scenario
from .steps import SCENARIO_NAME


def driven_scenario(simulation: Simulation, rollout: Rollout) -> Scenario:
    """Return the scenario of what was driven: the simulated one, with the trajectories that resulted and the captures' times."""
    context, base = simulation.context, simulation.scenario
    drive, before = simulation.scenario_drive.base, context.drive.world_from_ego
    ego = rollout.ego_keys
    if ego and ego[0].time_s > before.times_s[0] and _starts_on_log(simulation):
        ego = (*recorded_keys(before, None, ego[0].time_s), *ego)
    actors = {
        uid: (*recorded_keys(drive.actors[uid].world_from_actor, None, keys[0].time_s), *keys)
        for uid, keys in rollout.keys.items()
    }
    moved = edits_of(simulation.scenario_drive, ego, actors, rollout.end.strayed, rollout.end.vanished_s)
    own = simulation.scenario_drive.context.scenario.edits
    # where the vehicle goes is told to the end
    outside = Outside(actors_outside(base), "continue") if ego else base.outside
    times: dict[str, list[float]] = {}
    for exposure in context.exposures:
        times.setdefault(exposure.capture.sensor_id, []).append(exposure.capture.time_us / US_PER_SECOND)
    assert base.sensors is not None
    sensors = base.sensors.with_times(lambda spec: tuple(sorted(times.get(spec.id, ()))))
    return replace(
        base, edits=(*own, *moved), sensors=sensors, outside=outside, path=simulation.out / SCENARIO_NAME,
        simulation=replace(simulation.spec, jitter=None),  # its starts are drawn
        description=f"driven by {simulation.kind.name}",
    )  # fmt: skip


def _starts_on_log(simulation: Simulation) -> bool:
    jitter = simulation.spec.jitter
    return jitter is None or not any((jitter.ego_along_m, jitter.ego_aside_m, jitter.ego_yaw_deg, jitter.ego_speed_m_s))


def finish(simulation: Simulation, rollout: Rollout, options: RenderOptions) -> RenderReport:
    """Write a rollout's scenario and make its folder the rendering of that scenario. What it rendered anew was not what the
    driver saw: there is none, unless files of the folder were changed."""
    scenario = driven_scenario(simulation, rollout)
    save_scenario(scenario, scenario.path)
    options = replace(options, frames=None, times=None, sensors=None, scene=None)
    plan, _ = plan_scenario(scenario.path, options, simulation.scenes)
    return render_sequence(plan, simulation.out, jobs=1, resume=True)


Write = Callable[[Path], object]
"""Writes a finished rollout's folder in further formats, into that folder."""


@dataclass(frozen=True)
class FinishedRollout:
    """A rollout that is finished: its ``seed`` and ``scores``; ``captures`` are in its folder, of which ``anew`` are not what the
    driver saw."""

    seed: int
    scores: dict[str, Any]
    captures: int
    anew: int


def complete(
    simulation: Simulation,
    options: RenderOptions,
    on_step: Callable[[World], object] = lambda world: None,
    write: Write = lambda folder: None,
) -> FinishedRollout:
    """Run a simulation and write all that its folder holds; last, what ``write`` makes of the folder. Raises `UnisimError`."""
    simulation.road()  # what is wrong with its sweeps is told before the drive
    rollout = roll_out(simulation, on_step)
    report = finish(simulation, rollout, options)
    scores = scores_of(simulation, rollout)
    write_file(simulation.out / SCORES_NAME, json_bytes(scores))
    write(simulation.out)
    return FinishedRollout(simulation.spec.seed or 0, scores, report.captures_kept + report.captures, report.captures)


def _none(opened: OpenedScenario) -> Write:
    return lambda folder: None


@dataclass(frozen=True)
class Seeds:
    """Rollouts of one scenario, each with a seed and a folder of its own, ``out/seed-N``. It pickles: an executor calls it once
    in each process, whose rollouts share the scene that it loads. ``formats`` returns what writes them; it may refuse."""

    path: Path | str
    options: RenderOptions
    asked: SimulationSpec
    driver: str
    out: Path
    resume: bool = False
    endpoint: Endpoint | None = None
    formats: Callable[[OpenedScenario], Write] = _none

    def __call__(self) -> Callable[[int], FinishedRollout]:
        """Open the scenario and return the function that runs the rollout of a seed."""
        with single_threaded():
            opened = open_scenario(self.path, self.options)
        write = self.formats(opened)

        def run(seed: int) -> FinishedRollout:
            with hold_folder(self.out / f"seed-{seed}"), single_threaded():
                return complete(self._simulation(opened, seed), self.options, write=write)

        return run

    def _simulation(self, opened: OpenedScenario, seed: int) -> Simulation:
        out = self.out / f"seed-{seed}"
        simulation = opened.simulation(replace(self.asked, seed=seed), driver_named(self.driver, self.endpoint), out)
        note_scenario(simulation.scenario, out, self.resume)
        return simulation


def run_seeds(seeds: Seeds, first: int, count: int, jobs: int) -> Iterator[FinishedRollout]:
    """Run ``count`` rollouts with the seeds from ``first`` on in ``jobs`` processes, and yield each as it is finished. Their
    files do not depend on the number of processes. Raises `UnisimError`; what is finished stays."""
    numbers = range(first, first + count)
    try:
        # one job has a process of its own, too: libraries that use several threads round sums differently
        yield from results_of(EXECUTORS["processes"].run(seeds, numbers, jobs))
    except ProcessLost as error:
        raise OutputError(
            f"{seeds.out}: {error}; finished rollouts are kept, continue with --resume and fewer --jobs"
        ) from error
