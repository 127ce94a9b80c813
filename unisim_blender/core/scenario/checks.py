"""Checks of documents: faults with their place in the file, and limits of size.

A document beyond the limits would take minutes and gigabytes, or have numbers that float64 cannot distinguish.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from ..errors import ScenarioError


def fail(place: str, problem: str) -> NoReturn:
    """Raise `ScenarioError` for a place of the scenario, such as ``scenario.json: edits[3].actor``."""
    raise ScenarioError(f"{place}: {problem}")


def require(holds: bool, place: str, problem: str) -> None:
    """Raise `ScenarioError` for a place of the scenario where something does not hold."""
    if not holds:
        fail(place, problem)


def listed(names: Iterable[str]) -> str:
    """Return the names in brackets, the middle left out where there are many."""
    known = sorted(names)
    if not known:
        return "(there are none)"
    if len(known) <= 6:
        return f"(there are {', '.join(known)})" if len(known) > 1 else f"(there is {known[0]})"
    return f"(there are {known[0]} … {known[-1]})"


MAX_MEMBERS = {
    "edits": 2_000,
    "boxes": 2_000,
    "cameras": 500,
    "lidars": 500,
    "frames": 100_000,
    "times": 100_000,
    "trajectory": 20_000,
    "shift": 20_000,
    "map": 20_000,
    "street": 100,
    "street_lamps": 500,
}
"""Largest number of members of a list or an object, by its name."""
MAX_VALUES = 500_000
"""Largest number of values of a document, of all kinds and at any depth: some 50 000 keys."""
MAX_M = 1e6
"""Largest absolute coordinate or length, metres, where float64 still distinguishes micrometres."""
MAX_S = 1e6
MAX_DEG = 1e6
MAX_PIXELS = 1e6
MIN_SPEED_FACTOR, MAX_SPEED_FACTOR = 1e-3, 1e3
"""Smallest and largest factor on the speed of a retimed actor."""
_UNITS = {"_m": (MAX_M, "m"), "_s": (MAX_S, "s"), "_deg": (MAX_DEG, "degrees")}
_NAMES = {
    "position": (MAX_M, "m"), "street_lamps": (MAX_M, "m"), "map": (MAX_S, "s"), "times": (MAX_S, "s"),
    **dict.fromkeys(("fx", "fy", "cx", "cy"), (MAX_PIXELS, "pixels")),
    "factors": (MAX_M, "times"), "quaternion_wxyz": (MAX_M, "in length"),
}  # fmt: skip


def check_limits(document: Any, path: Path) -> None:
    """Raise `ScenarioError` for the first place of a JSON document that holds more, or a larger
    number, than is read."""
    count = 0
    for steps, value in _values((), document):
        count += 1
        if count > MAX_VALUES:
            raise ScenarioError(f"{path}: holds more than {MAX_VALUES} values, which is more than a scenario may have")
        name = next((step for step in reversed(steps) if isinstance(step, str)), "")
        most = MAX_MEMBERS.get(name, MAX_VALUES) if steps and steps[-1] == name else MAX_VALUES
        if isinstance(value, list | dict) and len(value) > most:
            raise ScenarioError(
                f"{place_in(path, steps)}: has {len(value)} members, more than the {most} that are read"
            )
        if isinstance(value, int | float) and not isinstance(value, bool) and "street" not in steps:
            _check_number(value, name, place_in(path, steps))


def _check_number(value: float, name: str, place: str) -> None:
    unit = _NAMES.get(name) or next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), None)
    if unit is not None and not abs(value) <= unit[0]:
        raise ScenarioError(f"{place}: {value:g} is not within {unit[0]:g} {unit[1]}")
    if name == "speed" and value > 0 and not MIN_SPEED_FACTOR <= value <= MAX_SPEED_FACTOR:
        raise ScenarioError(f"{place}: {value:g} is not from {MIN_SPEED_FACTOR:g} to {MAX_SPEED_FACTOR:g}")


def place_in(path: Path, steps: tuple[str | int, ...]) -> str:
    """Return a file and a place in it: ``scenario.json: edits[3].actor``."""
    text = steps_in_words(steps).removeprefix(".")
    return f"{path}: {text}" if text else str(path)


def steps_in_words(steps: tuple[str | int, ...]) -> str:
    """Return the steps from a document's member to one below it: ``[3].actor``."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)


def _values(steps: tuple[str | int, ...], value: Any) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    yield steps, value
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, member in members:
        yield from _values((*steps, key), member)
