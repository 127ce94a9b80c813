"""What a driver is, and the drivers that are registered."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

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


class DriverKind(Protocol):
    """A driver by its name."""

    @property
    def name(self) -> str:
        """What `unisim drive --driver` calls it."""
        ...

    @property
    def about(self) -> str:
        """What it does, in a few words for the command line's help."""
        ...

    @property
    def privileged(self) -> bool:
        """Whether it is told where everything is: not a driver whose scores compare with others'."""
        ...

    @property
    def drives(self) -> bool:
        """Whether it moves the vehicle: a driver that replays the log does not."""
        ...

    @property
    def start(self) -> Callable[[Setup], Driver]:
        """Gives the driver of one rollout."""
        ...


DRIVERS: dict[str, DriverKind] = {}
"""The registered drivers by the name that `unisim drive --driver` has for them."""
Kind = TypeVar("Kind", bound=DriverKind)


def register(kind: Kind) -> Kind:
    """Register a driver. Returns it. Raises `ValueError` for a name that is taken."""
    if kind.name in DRIVERS:
        raise ValueError(f"there is a driver {kind.name!r} already")
    DRIVERS[kind.name] = kind
    return kind
