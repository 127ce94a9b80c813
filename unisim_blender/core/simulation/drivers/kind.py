"""A driver that is told of by its parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..observations import Setup
from .driver import Driver


@dataclass(frozen=True)
class NamedDriver:
    """A `DriverKind`."""

    name: str
    about: str
    start: Callable[[Setup], Driver]
    privileged: bool = False
    drives: bool = True
