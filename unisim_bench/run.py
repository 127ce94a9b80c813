"""A measurement from paths to files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from unisim_blender.core.files import holds_out
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.progress import Bar

from .cases import BenchmarkCase, all_cases, subject_of
from .machine import machine
from .measure import MeasuringProcesses, measure, turns
from .methods import DEFAULT, VARIANTS, all_methods, cores, has_torch
from .report.files import document, write_report
from .settings import Settings

PLOTS = "plots, for which matplotlib is needed: pip install '.[bench]' in the folder of the sources"


@holds_out
def run_bench(
    scenes: Sequence[Path],
    log: Path | None,
    out: Path,
    settings: Settings,
    say: Callable[[str], object],
    quiet: bool = False,
) -> None:
    """Measure the first scene in full and the others in their size, and write ``out``; ``say`` is told what is left out
    and what was written. Whatever ends it early, what was measured until then is written. Raises `UnisimError`."""
    subjects = [subject_of(scene, open_log(log) if log and not i else None) for i, scene in enumerate(scenes)]
    cases: list[BenchmarkCase] = []
    complete = False
    processes = MeasuringProcesses()
    try:
        variants, torch = processes.variants(), has_torch()
        where = machine(variants[DEFAULT])
        left_out = [
            f"{name}, which this processor or build does not have" for name in VARIANTS if variants[name] != name
        ]
        left_out += [] if torch else ["torch, which is not installed"]
        for what in left_out:
            say(f"Left out: {what}.")
        cases = all_cases(subjects, all_methods(variants, cores(), torch), settings)
        with Bar(total=turns(cases, settings.rounds), unit="render", dynamic_ncols=True, disable=quiet) as bar:
            measure(cases, processes, settings.rounds, bar.set_description, bar.update)
        complete = True
    finally:
        processes.close()
        if any(entry.measurements for case in cases for entry in case.entries):
            found = document(cases, str(scenes[0]), settings, where, left_out, complete)
            try:
                written = write_report(out, found)
                say(f"Written: {', '.join(map(str, written))}")
            except ModuleNotFoundError as error:
                if error.name is None or error.name.partition(".")[0] != "matplotlib":
                    raise
                say(f"Written: {out / 'bench.json'}, {out / 'bench.md'}. Left out: {PLOTS}.")
