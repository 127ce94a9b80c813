"""The driver: what sensors deliver is detected and tracked, the tracks are forecast, and a plan is made around them."""

from __future__ import annotations

import math
from bisect import bisect_right

from unisim_blender.core.simulation.drivers.driver import CameraImage, DriverSetup, EgoMotion, LidarSweep, Observation
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Plan

from .candidates import TIMES_S
from .forecast import forecast
from .lattice import LatticePlanner, Planned
from .objects import Mode, Track
from .route import Route
from .sensing import Detectors, Sensing
from .tracker import Tracker, predicted

LEAST_M_S = 3.0
"""A vehicle that starts slower wants to go this fast."""


class Perception:
    """Drives along the route at the speed that it starts with, or at ``wanted_m_s``, around what its detectors find.

    After `drive`, ``tracks`` and ``forecasts`` (at `TIMES_S`) are those that the plan was made around.
    """

    def __init__(self, setup: DriverSetup, detectors: Detectors, wanted_m_s: float | None = None) -> None:
        self.setup = setup
        self.sensing = Sensing(setup, detectors)
        self.tracker = Tracker()
        self.route = Route.through(setup.route)
        self.tracks: list[Track] = []
        self.forecasts: list[tuple[Mode, ...]] = []
        self.planned: Planned | None = None
        self._motion: list[EgoMotion] = []
        self._wanted_m_s = wanted_m_s

    def drive(self, observation: Observation) -> Plan:
        """See `Driver.drive`."""
        self.perceive(observation)
        if self._wanted_m_s is None:
            self._wanted_m_s = max(observation.ego.speed_m_s, LEAST_M_S)
        planner = LatticePlanner(self.setup.vehicle, self.route, self._wanted_m_s)
        self.planned = planner.plan(observation.time_us, observation.ego, self.forecasts)
        return self.planned.plan

    def close(self) -> None:
        """See `Driver.close`."""

    def perceive(self, observation: Observation) -> None:
        """Detect and track what was delivered, and forecast the tracks from now on."""
        self._motion = [*self._motion[-20:], *observation.motion]
        measured: list[CameraImage | LidarSweep] = sorted(
            (*observation.images, *observation.sweeps), key=lambda one: (one.end_us, one.sensor_id)
        )
        for one in measured:
            if isinstance(one, CameraImage):
                time_us = (one.start_us + one.end_us) // 2
                found = self.sensing.of_image(one, self._ego_at(time_us))
            else:
                # points are where they were in the sweep's frame at its time; vehicles ahead were passed half a turn before
                time_us = (one.start_us + one.end_us) // 2
                found = self.sensing.of_sweep(one, self._ego_at(one.time_us))
            self.tracker.update(time_us / 1e6, found)
        now_s = observation.time_us / 1e6
        self.tracks = [predicted(track, now_s) for track in self.tracker.confirmed]
        self.forecasts = [forecast(track, self.route, TIMES_S) for track in self.tracks]

    def _ego_at(self, time_us: int) -> EgoState:
        """Return the vehicle's pose at a time, linear between the states that are known, and on at the last one's speed."""
        motion = self._motion
        i = bisect_right([one.time_us for one in motion], time_us) - 1
        if i < 0:
            return motion[0].state
        before = motion[i].state
        if i + 1 == len(motion):
            ahead = before.speed_m_s * (time_us - motion[i].time_us) / 1e6
            return _moved(before, ahead * math.cos(before.heading_rad), ahead * math.sin(before.heading_rad), 0.0)
        after = motion[i + 1].state
        u = (time_us - motion[i].time_us) / (motion[i + 1].time_us - motion[i].time_us)
        turned = math.remainder(after.heading_rad - before.heading_rad, math.tau)
        return _moved(before, u * (after.x_m - before.x_m), u * (after.y_m - before.y_m), u * turned)


def _moved(state: EgoState, x_m: float, y_m: float, turned_rad: float) -> EgoState:
    return EgoState(state.x_m + x_m, state.y_m + y_m, state.heading_rad + turned_rad, state.speed_m_s)


def perception(setup: DriverSetup) -> Perception:
    """Return the driver, with the detectors of the folder that ``PERCEPTION_WEIGHTS`` names. Raises `UnisimError`."""
    return Perception(setup, Detectors.from_environment())
