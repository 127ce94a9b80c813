"""How what is wrong with a scenario is told: its place in the file, then a sentence."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NoReturn

from ..errors import ScenarioError


def fail(place: str, problem: str) -> NoReturn:
    """Raise `ScenarioError` for a place of the scenario, such as ``scenario.json: edits[3].actor``."""
    raise ScenarioError(f"{place}: {problem}")


def require(holds: bool, place: str, problem: str) -> None:
    """Raise `ScenarioError` for a place of the scenario where something does not hold."""
    if not holds:
        fail(place, problem)


def listed(names: Iterable[str]) -> str:
    """The names there are, in brackets, the middle left out where there are many."""
    known = sorted(names)
    if not known:
        return "(there are none)"
    if len(known) <= 6:
        return f"(there are {', '.join(known)})" if len(known) > 1 else f"(there is {known[0]})"
    return f"(there are {known[0]} … {known[-1]})"
