"""The lattice planner: of the candidates that keep to the vehicle's limits and meet no forecast, the one of the least cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.geometry import BoolArray, FloatArray
from unisim_blender.core.simulation.footprints import overlap, radii
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Plan
from unisim_blender.core.simulation.vehicle.parameters import Vehicle

from .candidates import HARDEST_M_S2, OFFSETS_M, TIMES_S, Candidates, Start, candidates
from .objects import Mode
from .route import Route

ALONG_M, ASIDE_M = 1.5, 0.25
"""The vehicle's box is longer ahead and wider on each side by so much where it is checked for collisions."""
GAP_M = 3.5
"""Stops are planned so far behind a box."""
CORRIDOR_M = 0.5
"""A box that reaches within so much of the vehicle's sides is stopped behind."""
MOST_M_S2, ACROSS_M_S2 = 3.0, 4.0
"""Limits of the acceleration, along and across."""
SPEED_COST = 4.0
"""Of the mean speed that is missing. Not of its square: on the way to a stop that would be least for an even, slow speed."""
ACCELERATION_COST, JERK_COST, OFFSET_COST, SLOPE_COST = 0.5, 0.1, 2.0, 20.0
"""Of mean squares: acceleration and jerk along the route, distance from it and its change by the distance driven."""


@dataclass(frozen=True, eq=False)
class Planned:
    """A plan. ``is_free`` is false where every candidate meets a forecast and the vehicle brakes as hard as it can."""

    plan: Plan
    is_free: bool


class LatticePlanner:
    """Plans along a route at a speed that is wanted, behind and beside what is forecast."""

    def __init__(self, vehicle: Vehicle, route: Route, wanted_m_s: float) -> None:
        self.vehicle, self.route, self.wanted_m_s = vehicle, route, wanted_m_s

    def plan(self, time_us: int, ego: EgoState, forecasts: Sequence[Sequence[Mode]]) -> Planned:
        """Return the plan from now on. ``forecasts`` are each vehicle's, at `TIMES_S`."""
        start = Start.of(ego, self.vehicle, self.route)
        modes = [mode for one in forecasts for mode in one if not self._is_behind(mode, start)]
        made = candidates(start, self.route, self.wanted_m_s, self._stops(modes, start))
        costs = np.where(keeps_limits(made), cost_of(made, self.wanted_m_s), np.inf)
        free = ~self._meets(made, modes)
        index = int(np.argmin(np.where(free, costs, np.inf)))
        if not np.isfinite(costs[index]) or not free[index]:
            # the last rows brake, one for each offset: the one that changes it least
            last = np.arange(len(costs))[-len(OFFSETS_M) :]
            return Planned(_plan_of(made, int(last[np.argmin(np.abs(made.slope[last]).max(1))]), time_us), False)
        return Planned(_plan_of(made, index, time_us), True)

    def _is_behind(self, mode: Mode, start: Start) -> bool:
        """Return whether a box is behind the vehicle, which stays in its lane: it is that one that has to wait."""
        return self.route.project(*mode.boxes[0, :2].tolist())[0] < start.along[0]

    def _stops(self, modes: Sequence[Mode], start: Start) -> tuple[float, ...]:
        """Return the places along the route at which the rear axle stands a gap behind what is or comes into the way."""
        ahead = self.vehicle.length_m - self.vehicle.rear_overhang_m
        reach = self.vehicle.width_m / 2 + CORRIDOR_M
        stops = set()
        for mode in modes:
            for box in mode.boxes[[0, mode.trusted // 2, mode.trusted - 1]]:
                s, d = self.route.project(*box[:2].tolist())
                if abs(d - start.across[0]) - box[3] / 2 <= reach and s > start.along[0]:
                    stops.add(round(s - box[2] / 2 - ahead - GAP_M, 1))
        return tuple(sorted(stops))

    def _meets(self, made: Candidates, modes: Sequence[Mode]) -> BoolArray:
        """Return which candidates (C,) meet a forecast at one of the times."""
        met = np.zeros(len(made.s_m), bool)
        ego = self._boxes(made)
        for mode in modes:
            upto = mode.trusted
            others = mode.boxes[:upto]
            apart = np.hypot(*np.moveaxis(ego[:, :upto, :2] - others[:, :2], -1, 0))
            near = (apart <= radii(ego[:, :upto]) + radii(others)) & ~met[:, None]
            rows, times = np.nonzero(near)
            hits = overlap(ego[rows, times], others[times])
            met[rows[hits]] = True
        return met

    def _boxes(self, made: Candidates) -> FloatArray:
        """The vehicle's boxes (C, T, 5) with their margins."""
        vehicle = self.vehicle
        length = vehicle.length_m + ALONG_M
        middle = length / 2 - vehicle.rear_overhang_m
        return np.stack(
            [
                made.x_m + middle * np.cos(made.heading_rad),
                made.y_m + middle * np.sin(made.heading_rad),
                np.full_like(made.x_m, length),
                np.full_like(made.x_m, vehicle.width_m + 2 * ASIDE_M),
                made.heading_rad,
            ],
            -1,
        )


def keeps_limits(made: Candidates) -> BoolArray:
    """Return which candidates (C,) never go backwards and keep to the limits of acceleration, along and across."""
    turning = np.diff(made.heading_rad, axis=-1) / np.diff(TIMES_S) * made.speed_m_s[:, 1:]
    return np.asarray(
        (made.rate >= -0.05).all(1)
        & (made.acceleration[:, 1:] >= -HARDEST_M_S2).all(1)
        & (made.acceleration[:, 1:] <= MOST_M_S2).all(1)
        & (np.abs(turning) <= ACROSS_M_S2).all(1)
    )


def cost_of(made: Candidates, wanted_m_s: float) -> FloatArray:
    """Return the candidates' costs (C,)."""
    parts = (
        (ACCELERATION_COST, made.acceleration),
        (JERK_COST, made.jerk),
        (OFFSET_COST, made.d_m),
        (SLOPE_COST, made.slope),
    )
    missing = SPEED_COST * np.abs(made.rate - wanted_m_s).mean(1)
    return np.asarray(missing + sum(weight * (values**2).mean(1) for weight, values in parts))


def _plan_of(made: Candidates, index: int, time_us: int) -> Plan:
    times = time_us + np.round(TIMES_S * 1e6).astype(np.int64)
    return Plan(times, made.x_m[index], made.y_m[index], made.heading_rad[index], made.speed_m_s[index])
