"""The package's own drivers: `log`, `constant` and `idm`.

`log` follows the recorded poses, whatever happens. `constant` goes straight on at the speed that it starts with. `idm` follows
the recorded path behind whatever is in the way; it is privileged: it is told where everything is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...world.actor_path import ActorPath, yaw_of
from ...world.drive import EGO
from ..actors.follow import IdmParameters as Idm
from ..actors.follow import PathProgress, advanced, search_of
from ..actors.lead import find_leads
from ..states import EgoState
from ..vehicle.actions import Plan
from ..world import FollowLog
from .driver import DriverKind, DriverSetup, Observation, register


class LogDriver:
    """Follows the log's poses; neither the vehicle's dynamics nor the tracker take part."""

    def __init__(self, setup: DriverSetup) -> None:
        del setup

    def drive(self, observation: Observation) -> FollowLog:
        del observation
        return FollowLog()

    def close(self) -> None:
        """See `Driver.close`."""


LOG = register(DriverKind("log", "the recorded poses", LogDriver, drives=False))


AHEAD_S, POSES = 4.0, 9


class ConstantDriver:
    """Plans straight on from where it started, at a constant speed."""

    def __init__(self, setup: DriverSetup) -> None:
        del setup
        self._begun: tuple[int, EgoState] | None = None

    def drive(self, observation: Observation) -> Plan:
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


PLAN_STEP_US, PLAN_POSES = 250_000, 17
"""Time between a plan's poses, and their number: four seconds in all."""


class IdmDriver:
    """Follows the recorded path, continued along other actors' paths, by the Intelligent Driver Model at the recorded speeds."""

    def __init__(self, setup: DriverSetup) -> None:
        assert setup.recording is not None
        self._path = setup.recording.continued(EGO)
        self._back_m = setup.vehicle.length_m / 2 - setup.vehicle.rear_overhang_m
        self._size_m = setup.vehicle.length_m, setup.vehicle.width_m
        self._driver = Idm()

    def drive(self, observation: Observation) -> Plan:
        assert observation.traffic is not None
        box = observation.traffic.ego
        if self._path is None:
            return Plan.at_rest(observation.time_us, observation.ego)
        s, _ = self._path.project(box.x_m, box.y_m)
        progress = PathProgress(self._path, s, observation.ego.speed_m_s, observation.ego.acceleration_m_s2)
        (lead,) = find_leads([search_of(progress, self._driver, self._size_m, EGO)], observation.traffic)
        places, speeds = [s], [progress.speed_m_s]
        for number in range(1, PLAN_POSES):
            before = progress.s_m
            time_us = observation.time_us + (number - 1) * PLAN_STEP_US
            progress = advanced(progress, self._driver, lead, time_us, PLAN_STEP_US)
            if lead is not None:
                away = lead.speed_m_s * PLAN_STEP_US / 1e6 - (progress.s_m - before)
                lead = replace(lead, gap_m=lead.gap_m + away)
            places.append(progress.s_m)
            speeds.append(progress.speed_m_s)
        return _along(self._path, places, speeds, self._back_m, observation.time_us)

    def close(self) -> None:
        """See `Driver.close`."""


def _along(path: ActorPath, places: list[float], speeds: list[float], back_m: float, time_us: int) -> Plan:
    """Return the plan of a box's middle at arc lengths of a path; the rear axle lies ``back_m`` behind it."""
    poses = [path.place(s) for s in places]
    heading = np.array([float(yaw_of(np.array(quaternion))) for _, quaternion in poses])
    x, y = (np.array([position[axis] for position, _ in poses]) for axis in (0, 1))
    return Plan(
        time_us + PLAN_STEP_US * np.arange(len(places)),
        x - back_m * np.cos(heading),
        y - back_m * np.sin(heading),
        heading,
        np.array(speeds),
    )


IDM = register(
    DriverKind("idm", "privileged: along the recorded path, behind what is in the way", IdmDriver, privileged=True)
)
