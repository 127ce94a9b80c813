"""The driver `log`: the vehicle is where it was recorded, whatever happens."""

from __future__ import annotations

from ..observations import DriverSetup, Observation
from ..world import FollowLog
from .driver import DriverKind, register


class LogDriver:
    """Follows the log's poses; neither the vehicle's dynamics nor the tracker take part."""

    def __init__(self, setup: DriverSetup) -> None:
        del setup

    def drive(self, observation: Observation) -> FollowLog:
        """See `Driver.drive`."""
        del observation
        return FollowLog()

    def close(self) -> None:
        """See `Driver.close`."""


LOG = register(DriverKind("log", "the recorded poses", LogDriver, drives=False))
