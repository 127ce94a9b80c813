"""The jobs of a batch: scenarios to render or to drive through, of scenario files, logs, JSON lines and sweeps."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import ScenarioError
from ...formats.readers import reader_of
from ...json_file import check_finite
from ...prepare.scenario import scenario_at
from ...remote.requests import is_url
from ...scenario.types import Scenario
from .sources import JobFile
from .sweep import SWEEP_FORMAT, set_field, variants_of

LINES_SUFFIX = ".jsonl"
LINE_MEMBERS = {"name", "scenario", "set", "driver", "seed"}


@dataclass(frozen=True)
class BatchJob:
    """A variant: the captures of a scenario or, with a ``driver``, one closed-loop rollout of it.

    ``name`` is a folder's, unlike that of other jobs. ``parameters`` are what a sweep chose. ``seed`` is that of the rollout,
    None for the scenario's.
    """

    name: str
    scenario: Scenario
    parameters: Mapping[str, Any] = field(default_factory=dict)
    driver: str | None = None
    seed: int | None = None


def read_jobs(names: Sequence[Path | str], driver: str | None = None, seed: int | None = None) -> tuple[BatchJob, ...]:
    """Read and check all jobs: of scenario files, logs, sweep documents, and files of JSON lines (``.jsonl``), by paths or URLs.

    ``driver`` and ``seed`` hold for jobs that name none. Raises `UnisimError`, which names the file and the place in it.
    """
    jobs: list[BatchJob] = []
    taken: set[str] = set()
    for one in names:
        for job in _jobs_in(one):
            name = _free(_slug(job.name), taken)
            taken.add(name.lower())
            own = job.driver or driver
            own_seed = seed if job.seed is None else job.seed
            jobs.append(BatchJob(name, job.scenario, job.parameters, own, own_seed))
    return tuple(jobs)


def _jobs_in(name: Path | str) -> Iterator[BatchJob]:
    if is_url(name) and not str(name).endswith((LINES_SUFFIX, ".json")):
        scenario = scenario_at(name)
        yield BatchJob(scenario.name, scenario)
        return
    source = JobFile.of(name)
    with source.named():
        yield from _jobs_of(source)


def _jobs_of(source: JobFile) -> Iterator[BatchJob]:
    path = source.path
    if path.suffix == LINES_SUFFIX:
        yield from _lines(source)
        return
    if path.is_dir() or (source.url is None and reader_of(path) is not None):
        scenario = scenario_at(path)
        yield BatchJob(scenario.name, scenario)
        return
    document = source.json()
    if not isinstance(document, dict) or document.get("format") != SWEEP_FORMAT:
        scenario = source.scenario(document)
        yield BatchJob(scenario.name, scenario)
        return
    for number, (values, filled, file) in enumerate(variants_of(document, source)):
        told = ", ".join(f"{name} = {json.dumps(value)}" for name, value in values.items())
        scenario = _checked(filled, file, f"{source}: variant {number} ({told})")
        yield BatchJob(f"{document['name']}-{number:04d}", scenario, values, document.get("driver"))


def _checked(document: Any, file: JobFile, place: str) -> Scenario:
    """Return the scenario of a JSON value. Raises `ScenarioError` that begins with ``place``."""
    try:
        return file.scenario(document)
    except ScenarioError as error:
        raise ScenarioError(f"{place}: {error}") from error


def _lines(source: JobFile) -> Iterator[BatchJob]:
    """Jobs of JSON lines: a scenario's file or document, and what is set in it by JSON pointer."""
    path = source.path
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: cannot be read: {error}") from error
    for number, line in enumerate(lines, 1):
        if line.strip():
            yield _line(source, line, f"{path}: line {number}")


def _line(source: JobFile, line: str, place: str) -> BatchJob:
    try:
        job = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{place}: is not valid JSON: {error}") from error
    check_finite(job, f"{place}: ", ScenarioError)
    if not isinstance(job, dict) or not isinstance(job.get("scenario"), str | dict):
        raise ScenarioError(f'{place}: must be an object with "scenario": a path or a scenario')
    for name in job.keys() - LINE_MEMBERS:
        raise ScenarioError(f'{place}: "{name}" is not one of {", ".join(sorted(LINE_MEMBERS))}')
    kinds: dict[str, type] = {"name": str, "driver": str, "seed": int, "set": dict}
    for name, kind in kinds.items():
        if name in job and (not isinstance(job[name], kind) or isinstance(job[name], bool) or job[name] in ("",)):
            raise ScenarioError(f"{place}: {name}: {json.dumps(job[name])} is none")
    if job.get("seed", 0) < 0:
        raise ScenarioError(f"{place}: seed: {job['seed']} lies below 0")
    document, file = job["scenario"], source
    if isinstance(document, str):
        file = source.beside(document)
        document = file.json()
    for pointer, value in job.get("set", {}).items():
        set_field(document, pointer, value, f"{place}: set")
    scenario = _checked(document, file, place)
    return BatchJob(job.get("name") or scenario.name, scenario, job.get("set", {}), job.get("driver"), job.get("seed"))


def _slug(name: str) -> str:
    """Return a name that a folder and an object may have everywhere."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:80] or "scenario"


def _free(name: str, taken: Collection[str]) -> str:
    """Return the name, numbered where it is ``taken``, in small letters: their case makes no difference on some file systems."""
    number, found = 2, name
    while found.lower() in taken:
        found, number = f"{name}-{number}", number + 1
    return found
