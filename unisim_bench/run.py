"""A measurement from paths to files: the machine, bench.json, bench.md, and images where matplotlib is installed."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from unisim_blender.core import cuda_driver, native
from unisim_blender.core.evaluation.recorded import finite
from unisim_blender.core.files import holds_out, write_file
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.json_file import json_bytes
from unisim_blender.core.progress import Bar

from .cases import BenchmarkCase, all_cases, subject_of
from .measure import MeasuringProcesses, measure, turns
from .report.metrics import metrics_of
from .report.tables import markdown
from .settings import DEFAULT, VARIANTS, Settings, all_methods, cores, has_torch


def bench_document(
    cases: Sequence[BenchmarkCase],
    scene: str,
    settings: Settings,
    where: dict[str, object],
    left_out: Sequence[str],
    complete: bool,
) -> dict[str, Any]:
    """Everything that was measured, and where; ``left_out`` are sentences."""
    return {
        "scene": scene,
        "machine": where,
        "settings": asdict(settings),
        "left_out": list(left_out),
        "complete": complete,
        "metrics": metrics_of(cases),
    }


def write_bench_report(out: Path, report: dict[str, Any]) -> list[Path]:
    """Write the files and give their paths. Raises `OutputError`; ModuleNotFoundError, after the others are written,
    where matplotlib is missing."""
    files = {"bench.json": json_bytes(finite(report)), "bench.md": markdown(report).encode()}
    for name, data in files.items():
        write_file(out / name, data)
    from .report.plots import images

    drawn = images(report["metrics"])
    for name, data in drawn.items():
        write_file(out / name, data)
    return [out / name for name in (*files, *drawn)]


PACKAGES = ("unisim_blender", "numpy", "torch")


def machine(variant: str) -> dict[str, object]:
    """Processor, cores, load, instruction set, versions; the commit, where the sources lie in a repository."""
    return {
        "processor": processor(),
        "cores": cores(),
        "load": [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None,
        "system": platform.platform(terse=True),
        "gpu": "" if cuda_driver.unusable() else cuda_driver.gpu(0).name,
        "variant": variant,
        "kernels": native.ABI_VERSION,
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in PACKAGES},
        "commit": _commit(),
    }


def processor() -> str:
    """The processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _commit() -> str | None:
    """The commit, with + where files are changed beside it."""
    root = Path(__file__).parents[1]
    if not (root / ".git").exists():
        return None
    try:
        asked = ("git", "describe", "--always", "--abbrev=12", "--exclude=*", "--dirty=+")
        return subprocess.run(asked, cwd=root, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


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
        left_out += [f"rows of a GPU: {why}"] if (why := cuda_driver.unusable()) else []
        for what in left_out:
            say(f"Left out: {what}.")
        cases = all_cases(subjects, all_methods(variants, cores(), torch, gpu=not why), settings)
        with Bar(total=turns(cases, settings.rounds), unit="render", dynamic_ncols=True, disable=quiet) as bar:
            measure(cases, processes, settings.rounds, bar.set_description, bar.update)
        complete = True
    finally:
        processes.close()
        if any(entry.measurements for case in cases for entry in case.entries):
            report = bench_document(cases, str(scenes[0]), settings, where, left_out, complete)
            try:
                written = write_bench_report(out, report)
                say(f"Written: {', '.join(map(str, written))}")
            except ModuleNotFoundError as error:
                if error.name is None or error.name.partition(".")[0] != "matplotlib":
                    raise
                say(f"Written: {out / 'bench.json'}, {out / 'bench.md'}. Left out: {PLOTS}.")
