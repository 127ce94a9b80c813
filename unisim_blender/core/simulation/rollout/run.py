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
from ...prepare.scenario_plan import RenderOptions
from ...processes import single_threaded
from ...scenario.simulation.document import SimulationSpec
from ..drivers import Endpoint, driver_named
from ..world import World
from .finish import finish
from .loop import roll_out
from .opening import Opened, note, open_scenario
from .score import SCORES_NAME, scores_of
from .setup import Simulation

Write = Callable[[Path], object]
"""Writes a finished rollout's folder in further formats, into that folder."""


@dataclass(frozen=True)
class Done:
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
    film: bool = False,
    write: Write = lambda folder: None,
) -> Done:
    """Run a simulation and write all that its folder holds, a ``film`` only where it is asked for; last, what ``write`` makes of
    the folder. Raises `UnisimError`."""
    simulation.road()  # what is wrong with its sweeps is told before the drive
    rollout = roll_out(simulation, on_step)
    report = finish(simulation, rollout, options)
    scores = scores_of(simulation, rollout)
    write_file(simulation.out / SCORES_NAME, json_bytes(scores))
    if film:
        from .film import write_film  # which needs the encoder

        write_film(simulation, rollout)
    write(simulation.out)
    return Done(simulation.spec.seed or 0, scores, report.captures_kept + report.captures, report.captures)


def _none(opened: Opened) -> Write:
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
    film: bool = False
    endpoint: Endpoint | None = None
    formats: Callable[[Opened], Write] = _none

    def __call__(self) -> Callable[[int], Done]:
        """Open the scenario and return the function that runs the rollout of a seed."""
        with single_threaded():
            opened = open_scenario(self.path, self.options)
        write = self.formats(opened)

        def run(seed: int) -> Done:
            with hold_folder(self.out / f"seed-{seed}"), single_threaded():
                return complete(self._simulation(opened, seed), self.options, film=self.film, write=write)

        return run

    def _simulation(self, opened: Opened, seed: int) -> Simulation:
        out = self.out / f"seed-{seed}"
        simulation = opened.simulation(replace(self.asked, seed=seed), driver_named(self.driver, self.endpoint), out)
        note(simulation.scenario, out, self.resume)
        return simulation


def run_seeds(seeds: Seeds, first: int, count: int, jobs: int) -> Iterator[Done]:
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
