"""The driver `constant`: straight on at the speed that it starts with."""

from __future__ import annotations

import math

import numpy as np

from ..observations import DriverSetup, Observation
from ..states import EgoState
from ..vehicle.actions import Plan
from .driver import DriverKind, register

AHEAD_S, POSES = 4.0, 9


class ConstantDriver:
    """Plans straight on from where it started, at a constant speed."""

    def __init__(self, setup: DriverSetup) -> None:
        del setup
        self._begun: tuple[int, EgoState] | None = None

    def drive(self, observation: Observation) -> Plan:
        """See `Driver.drive`."""
        if self._begun is None:
            self._begun = observation.time_us, observation.ego
        begun_us, ego = self._begun
        after_s = np.linspace(0.0, AHEAD_S, POSES)
        times = observation.time_us + np.round(after_s * 1e6).astype(np.int64)
        away = ego.speed_m_s * (times - begun_us) / 1e6
        return Plan(
            times,
            ego.x_m + away * math.cos(ego.heading_rad),
            ego.y_m + away * math.sin(ego.heading_rad),
            np.full(POSES, ego.heading_rad),
            np.full(POSES, ego.speed_m_s),
        )

    def close(self) -> None:
        """See `Driver.close`."""


CONSTANT = register(DriverKind("constant", "straight on at the speed that it starts with", ConstantDriver))
