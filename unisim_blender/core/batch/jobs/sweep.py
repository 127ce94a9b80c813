"""Sweep documents: a scenario with parameters, whose values fill fields of it by JSON pointer."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ScenarioError, in_a_line
from ...geometry import FloatArray
from ...scenario.schema import check_by_schema
from .sources import JobFile

SWEEP_FORMAT = "unisim-sweep"
CHOICES = ("values", "range")
DRAWN = ("uniform", "integers")
MOST_VARIANTS = 100_000

_POINTER = {"type": "string", "pattern": "^(/.*)+$"}
_PARAMETER = {
    "type": "object",
    "properties": {
        "at": {"anyOf": [_POINTER, {"type": "array", "items": _POINTER, "minItems": 1}]},
        "values": {"type": "array", "minItems": 1},
        "range": {
            "type": "object",
            "properties": {
                "start": {"type": "number"},
                "stop": {"type": "number"},
                "count": {"type": "integer", "minimum": 1, "maximum": MOST_VARIANTS},
            },
            "required": ["start", "stop", "count"],
            "additionalProperties": False,
        },
        "uniform": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
        "integers": {"type": "array", "items": {"type": "integer"}, "minItems": 2, "maxItems": 2},
    },
    "required": ["at"],
    "additionalProperties": False,
}
SCHEMA: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "UniSim sweep, version 1",
    "type": "object",
    "properties": {
        "format": {"const": SWEEP_FORMAT},
        "version": {"const": 1},
        "name": {"type": "string", "minLength": 1},
        "scenario": {"type": ["string", "object"]},
        "driver": {"type": "string", "minLength": 1},
        "sampling": {
            "type": "object",
            "properties": {
                "method": {"enum": ["grid", "random", "latin-hypercube"]},
                "count": {"type": "integer", "minimum": 1, "maximum": MOST_VARIANTS},
                "seed": {"type": "integer", "minimum": 0},
            },
            "required": ["method"],
            "additionalProperties": False,
        },
        "parameters": {"type": "object", "minProperties": 1, "additionalProperties": _PARAMETER},
    },
    "required": ["format", "version", "name", "scenario", "parameters"],
    "additionalProperties": False,
}
"""The JSON Schema of sweep documents."""


def variants_of(document: Any, source: JobFile) -> Iterator[tuple[dict[str, Any], dict[str, Any], JobFile]]:
    """Yield for each variant of a sweep document the values of its parameters, its scenario as a JSON value that no schema has
    checked yet, and the file that paths in the scenario are relative to.

    ``source`` is the sweep's file. Raises `ScenarioError`, which names it and the pointer or the parameter.
    """
    path = source.path
    check_by_schema(document, SCHEMA, path)
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
    for name, one in parameters.items():
        kinds = [kind for kind in (*CHOICES, *DRAWN) if kind in one]
        if len(kinds) != 1:
            raise ScenarioError(f"{path}: parameters.{name}: must have one of {', '.join((*CHOICES, *DRAWN))}")
        if kinds[0] in DRAWN and one[kinds[0]][0] > one[kinds[0]][1]:
            raise ScenarioError(f"{path}: parameters.{name}.{kinds[0]}: its lower end lies above its upper one")
        if method == "grid" and kinds[0] in DRAWN:
            raise ScenarioError(f"{path}: parameters.{name}.{kinds[0]}: a grid has no draws; give values or a range")
    if method == "grid":
        choices = [_choices(one) for one in parameters.values()]
        if int(np.prod([len(some) for some in choices], dtype=float)) > MOST_VARIANTS:
            raise ScenarioError(f"{path}: parameters: make more than {MOST_VARIANTS} variants")
        return list(itertools.product(*choices))
    if "count" not in sampling:
        raise ScenarioError(f"{path}: sampling.count: is missing; the method {method} needs it")
    draws = _draws(method, sampling["count"], len(parameters), sampling.get("seed", 0))
    return [[_value(one, u) for one, u in zip(parameters.values(), row, strict=True)] for row in draws.tolist()]


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
