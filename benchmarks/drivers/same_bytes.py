"""Whether bytes repeat: of a seed, of one process and three, of a rollout's scenario rendered, of `log` and the replay."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.scenario import load_scenario, rebased, save_scenario, scenario_to_json
from unisim_blender.core.scenario.simulation import SimulationSpec
from unisim_blender.core.sequence.run import render_sequence
from unisim_blender.core.simulation.rollout.loop import roll_out
from unisim_blender.core.simulation.rollout.run import Seeds, complete, run_seeds
from unisim_blender.core.simulation.rollout.score import SCORES_NAME
from unisim_blender.core.simulation.rollout.setup import OpenedScenario, Simulation, note_scenario
from unisim_blender.core.simulation.rollout.steps import SCENARIO_NAME, STEPS_NAME

from .drivers import Entry

SEEN = ("camera", "lidar")
CAPTURES = (*SEEN, "labels")
DOCUMENTS = (STEPS_NAME, SCENARIO_NAME, SCORES_NAME)
SEEDS, PROCESSES = 3, (1, 3)


@dataclass(frozen=True)
class Check:
    """What was compared: ``files`` files, of which ``different`` are missing on one side or have other bytes."""

    what: str
    files: int
    different: tuple[str, ...]

    @property
    def kept(self) -> bool:
        """Whether there was something, and all of it the same."""
        return self.files > 0 and not self.different


def files_of(folder: Path, documents: bool = True, kinds: tuple[str, ...] = CAPTURES) -> dict[str, bytes]:
    """Return the bytes of all captures below a rollout's or a rendering's folder, and of a rollout's documents."""
    found = [path for kind in kinds for path in sorted((folder / kind).rglob("*")) if path.is_file()]
    found += [folder / name for name in DOCUMENTS] if documents else []
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def compared(what: str, one: dict[str, bytes], other: dict[str, bytes]) -> Check:
    """Return how two folders' files compare."""
    different = tuple(name for name in sorted(one.keys() | other.keys()) if one.get(name) != other.get(name))
    return Check(what, len(one), different)


def rendered(scenario: Path, out: Path, options: RenderOptions) -> Path:
    """Render a scenario as `unisim render` does in one process, and return its folder."""
    plan, _ = plan_scenario(scenario, options)
    render_sequence(plan, out, jobs=1)
    return out


def checks(
    entry: Entry, scenario: Path, opened: OpenedScenario, options: RenderOptions, asked: SimulationSpec, out: Path
) -> Iterator[Check]:
    """Yield the comparisons of a driver's rollouts through ``scenario``, whose starts are drawn by the seed; ``opened`` is that
    scenario. Raises `UnisimError`."""
    # what the driver saw, before the rollout's folder is made the rendering of its scenario
    seen = files_of(_rolled(entry, opened, asked, out / "seen" / "seed-0").out, False, SEEN)
    for name in ("once", "twice"):
        simulation = opened.simulation(replace(asked, seed=0), entry.kind(), out / name / "seed-0")
        note_scenario(simulation.scenario, simulation.out, False)
        complete(simulation, options)
    for jobs in PROCESSES:
        seeds = Seeds(scenario, options, asked, entry.driver, out / f"in-{jobs}", endpoint=entry.endpoint)
        list(run_seeds(seeds, 0, SEEDS, jobs))
    once = files_of(out / "once" / "seed-0")
    yield compared("the same seed twice", once, files_of(out / "twice" / "seed-0"))
    yield compared("this process and another", once, files_of(out / "in-1" / "seed-0"))
    one, three = (_all_seeds(out / f"in-{jobs}") for jobs in PROCESSES)
    yield compared(f"{PROCESSES[0]} and {PROCESSES[1]} processes, {SEEDS} seeds", one, three)
    again = rendered(out / "once" / "seed-0" / SCENARIO_NAME, out / "rendered", replace(options, sensors=None))
    yield compared("its scenario rendered", seen, files_of(again, False, SEEN))
    if not seeds_differ(out / "in-1"):
        yield Check("seeds differ", SEEDS, ("all seeds have the same captures",))


def _rolled(entry: Entry, opened: OpenedScenario, asked: SimulationSpec, out: Path) -> Simulation:
    """Run a rollout alone, whose captures stay as they were delivered, and return its simulation."""
    simulation = opened.simulation(replace(asked, seed=asked.seed or 0), entry.kind(), out)
    note_scenario(simulation.scenario, out, False)
    roll_out(simulation)
    return simulation


def _all_seeds(folder: Path) -> dict[str, bytes]:
    return {
        f"{seed}/{name}": data
        for seed in sorted(path.name for path in folder.iterdir())
        for name, data in files_of(folder / seed).items()
    }


def seeds_differ(folder: Path) -> bool:
    """Return whether no two seeds' rollouts have the same captures: else the comparisons above would show little."""
    found = [files_of(path, False) for path in sorted(folder.iterdir())]
    return all(a != b for i, a in enumerate(found) for b in found[i + 1 :])


def replay_check(
    entry: Entry,
    asked: Path,
    opened: OpenedScenario,
    duration_s: float,
    rollout: Path,
    out: Path,
    options: RenderOptions,
) -> Check:
    """Return how what the driver `log` sees in ``duration_s`` compares with ``asked``, the scenario that it is to drive through,
    rendered at the same times. ``rollout`` is its finished rollout of that length, which tells these times; the rollout's own
    edits take no part."""
    seen = _rolled(entry, opened, SimulationSpec(duration_s=duration_s), out / "seen").out
    before, driven = load_scenario(asked), load_scenario(rollout / SCENARIO_NAME)
    path = out / "replay.json"
    out.mkdir(parents=True, exist_ok=True)
    save_scenario(rebased(replace(before, sensors=driven.sensors, outputs=driven.outputs), path), path)
    replay = rendered(path, out / "replay", replace(options, sensors=None))
    found = compared("`log` is the replay", files_of(seen, False, SEEN), files_of(replay, False, SEEN))
    edits = [scenario_to_json(one)["edits"] for one in (before, driven)]
    return found if edits[0] == edits[1] else replace(found, different=(*found.different, "edits"))
