"""The jobs of a batch: scenarios to render or to drive through, of scenario files, logs, JSON lines and sweeps."""

from __future__ import annotations

import copy
import itertools
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ScenarioError, in_a_line
from ..formats.readers import reader_of
from ..geometry import FloatArray
from ..json_file import check_finite, read_json
from ..prepare.scenario import named, scenario_at
from ..remote.copies import local_path
from ..remote.requests import beside, is_url
from ..scenario import at_url, scenario_from_json
from ..scenario.json_schema import NUMBER, Schema, members_of, numbers
from ..scenario.schema import check_by_schema
from ..scenario.types import Scenario

LINES_SUFFIX = ".jsonl"
LINE_MEMBERS = {"name", "scenario", "set", "driver", "seed"}


@dataclass(frozen=True)
class JobFile:
    """A file at ``path``, which is a copy of what lies at ``url`` where that is given. As text it is its name."""

    path: Path
    url: str | None = None

    @staticmethod
    def of(name: Path | str) -> JobFile:
        """Return the file of a path or a URL. Raises `InputError` where it cannot be fetched."""
        return JobFile(local_path(str(name)), str(name)) if is_url(name) else JobFile(Path(name))

    def __str__(self) -> str:
        return self.url or str(self.path)

    def beside(self, name: str) -> JobFile:
        """Return the file that this one means by a name."""
        if self.url is not None:
            return JobFile.of(beside(self.url, name))
        return JobFile.of(name) if is_url(name) else JobFile((self.path.parent / name).resolve())

    @contextmanager
    def named(self) -> Iterator[None]:
        """Within it, errors that name the copy name the URL."""
        with named(self.path, str(self)):
            yield

    def json(self) -> Any:
        """Return the file's JSON document. Raises `ScenarioError`."""
        with self.named():
            return read_json(self.path, ScenarioError)

    def scenario(self, document: Any) -> Scenario:
        """Return the checked scenario of a JSON value whose relative paths lie beside the file. Raises `ScenarioError`."""
        with self.named():
            scenario = scenario_from_json(document, self.path)
        return scenario if self.url is None else at_url(scenario, self.url)


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
    for path in names:
        for job in _jobs_in(path):
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
        assignments = ", ".join(f"{name} = {json.dumps(value)}" for name, value in values.items())
        scenario = _checked(filled, file, f"{source}: variant {number} ({assignments})")
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
    number, unique = 2, name
    while unique.lower() in taken:
        unique, number = f"{name}-{number}", number + 1
    return unique


SWEEP_FORMAT = "unisim-sweep"
CHOICES = ("values", "range")
DRAWN = ("uniform", "integers")
MAX_VARIANTS = 100_000

_POINTER: Schema = {"type": "string", "pattern": "^(/.*)+$"}
_COUNT: Schema = {"type": "integer", "minimum": 1, "maximum": MAX_VARIANTS}
_PARAMETER = members_of(
    {
        "at": {"anyOf": [_POINTER, {"type": "array", "items": _POINTER, "minItems": 1}]},
        "values": {"type": "array", "minItems": 1},
        "range": members_of({"start": NUMBER, "stop": NUMBER, "count": _COUNT}, ["start", "stop", "count"]),
        "uniform": numbers(2),
        "integers": numbers(2, {"type": "integer"}),
    },
    ["at"],
)
_METHODS = "grid", "random", "latin-hypercube"
_SEED: Schema = {"type": "integer", "minimum": 0}
_SAMPLING = members_of({"method": {"enum": list(_METHODS)}, "count": _COUNT, "seed": _SEED}, ["method"])
_SWEEP = members_of(
    {
        "format": {"const": SWEEP_FORMAT},
        "version": {"const": 1},
        "name": {"type": "string", "minLength": 1},
        "scenario": {"type": ["string", "object"]},
        "driver": {"type": "string", "minLength": 1},
        "sampling": _SAMPLING,
        "parameters": {"type": "object", "minProperties": 1, "additionalProperties": _PARAMETER},
    },
    ["format", "version", "name", "scenario", "parameters"],
)
SWEEP_SCHEMA = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "UniSim sweep, version 1",
    **_SWEEP,
}
"""The JSON Schema of sweep documents."""


def variants_of(document: Any, source: JobFile) -> Iterator[tuple[dict[str, Any], dict[str, Any], JobFile]]:
    """Yield for each variant of a sweep document the values of its parameters, its scenario as a JSON value that no schema has
    checked yet, and the file that paths in the scenario are relative to.

    ``source`` is the sweep's file. Raises `ScenarioError`, which names it and the pointer or the parameter.
    """
    path = source.path
    check_by_schema(document, SWEEP_SCHEMA, path)
    base, file = document["scenario"], source
    if isinstance(base, str):
        file = source.beside(base)
        base = file.json()
    parameters: dict[str, dict[str, Any]] = document["parameters"]
    for row in _rows(document, path):
        values = dict(zip(parameters, row, strict=True))
        yield values, filled(base, parameters, values, path), file


def filled(base: Any, parameters: dict[str, dict[str, Any]], values: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a scenario with the parameters' values in the fields that they name. Raises `ScenarioError`."""
    scenario = copy.deepcopy(base)
    for name, value in values.items():
        at = parameters[name]["at"]
        for pointer in [at] if isinstance(at, str) else at:
            set_field(scenario, pointer, value, f"{path}: parameters.{name}.at")
    return scenario


def set_field(document: Any, pointer: str, value: Any, place: str) -> None:
    """Set the field at a JSON pointer (RFC 6901), in place; its parent must be there. Raises `ScenarioError`."""
    from jsonpointer import JsonPointer, JsonPointerException

    try:
        JsonPointer(pointer).set(document, copy.deepcopy(value))
    except (JsonPointerException, TypeError, IndexError) as error:
        raise ScenarioError(f'{place}: "{pointer}" leads nowhere in the scenario: {in_a_line(error)}') from error


def _rows(document: dict[str, Any], path: Path) -> list[Sequence[Any]]:
    """Return the values of the parameters, a row for each variant."""
    parameters, sampling = document["parameters"], document.get("sampling", {"method": "grid"})
    method = sampling["method"]
    for name, parameter in parameters.items():
        kinds = [kind for kind in (*CHOICES, *DRAWN) if kind in parameter]
        if len(kinds) != 1:
            raise ScenarioError(f"{path}: parameters.{name}: must have one of {', '.join((*CHOICES, *DRAWN))}")
        if kinds[0] in DRAWN and parameter[kinds[0]][0] > parameter[kinds[0]][1]:
            raise ScenarioError(f"{path}: parameters.{name}.{kinds[0]}: its lower end lies above its upper one")
        if method == "grid" and kinds[0] in DRAWN:
            raise ScenarioError(f"{path}: parameters.{name}.{kinds[0]}: a grid has no draws; give values or a range")
    if method == "grid":
        choices = [_choices(parameter) for parameter in parameters.values()]
        if int(np.prod([len(some) for some in choices], dtype=float)) > MAX_VARIANTS:
            raise ScenarioError(f"{path}: parameters: make more than {MAX_VARIANTS} variants")
        return list(itertools.product(*choices))
    if "count" not in sampling:
        raise ScenarioError(f"{path}: sampling.count: is missing; the method {method} needs it")
    draws = _draws(method, sampling["count"], len(parameters), sampling.get("seed", 0))
    return [
        [_value(parameter, u) for parameter, u in zip(parameters.values(), row, strict=True)] for row in draws.tolist()
    ]


def _draws(method: str, count: int, parameters: int, seed: int) -> FloatArray:
    """Return draws (count, parameters) in 0 … 1, equal for equal seeds."""
    if method == "random":
        return np.random.default_rng(seed).random((count, parameters))
    from scipy.stats import qmc

    return np.asarray(qmc.LatinHypercube(parameters, seed=seed).random(count))


def _choices(parameter: dict[str, Any]) -> list[Any]:
    if "values" in parameter:
        return list(parameter["values"])
    span = parameter["range"]
    return np.linspace(span["start"], span["stop"], span["count"]).tolist()


def _value(parameter: dict[str, Any], u: float) -> Any:
    """Return the value of a parameter for a draw ``u``, 0 ≤ u < 1."""
    if "uniform" in parameter:
        low, high = parameter["uniform"]
        return low + u * (high - low)
    if "integers" in parameter:
        low, high = parameter["integers"]
        return low + int(u * (high - low + 1))
    choices = _choices(parameter)
    return choices[int(u * len(choices))]
