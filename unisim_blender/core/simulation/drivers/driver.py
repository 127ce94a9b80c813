"""What a driver is, and the drivers that are registered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ..observations import Observation, Setup
from ..world import Action


class Driver(Protocol):
    """Drives one rollout. Its answers depend on what it was given alone: a rollout repeats them where it is resumed."""

    def drive(self, observation: Observation) -> Action:
        """Return what the vehicle is to do from now on: a `Control`, or a `Plan` that is tracked."""
        ...

    def close(self) -> None:
        """Give back what the driver holds; it is not asked again."""
        ...


@dataclass(frozen=True)
class Endpoint:
    """Where a driver's process listens: "HOST:PORT" or "unix:PATH". ``authority``: the file of the certificates by which another
    machine's is known, which goes with TLS."""

    address: str
    authority: Path | None = None


@dataclass(frozen=True)
class DriverKind:
    """A driver by the name that `unisim drive --driver` has for it. ``start`` gives the driver of one rollout.

    ``about`` says what it does, in a few words for the command line's help. A ``privileged`` driver is told where everything
    is: its scores do not compare with others'. ``drives``: whether it moves the vehicle; one that replays the log does not.
    ``remote``: of a driver that is a process of its own, what gives ``start`` for its address.
    """

    name: str
    about: str
    start: Callable[[Setup], Driver]
    privileged: bool = False
    drives: bool = True
    remote: Callable[[Endpoint], Callable[[Setup], Driver]] | None = None


DRIVERS: dict[str, DriverKind] = {}
"""The registered drivers by the name that `unisim drive --driver` has for them."""


def register(kind: DriverKind) -> DriverKind:
    """Register a driver. Returns it. Raises `ValueError` for a name that is taken."""
    if kind.name in DRIVERS:
        raise ValueError(f"there is a driver {kind.name!r} already")
    DRIVERS[kind.name] = kind
    return kind
