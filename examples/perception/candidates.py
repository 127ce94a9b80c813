"""The planner's candidates: motions along and across the route, and as poses in the world (Werling et al., ICRA 2010).

Along: quartics in time that arrive at a speed, quintics that stop at a place, and stops by a constant deceleration. Across:
quintics in the distance that is driven, which the paper has for low speeds: a standing vehicle does not move aside.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.parameters import Vehicle

from .polynomials import State, quartic, quintic, values
from .route import Route

HORIZON_S, STEP_S = 6.0, 0.25
TIMES_S = np.arange(0.0, HORIZON_S + STEP_S / 2, STEP_S)
"""Times (T,) of every candidate's poses after now."""
DURATIONS_S = (1.5, 2.5, 4.0, 6.0)
"""How long a change of the speed may take; how long a stop takes follows from the distance to the place."""
SPEED_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Speeds to arrive at, in the speed that is wanted."""
DECELERATIONS_M_S2, HARDEST_M_S2 = (1.0, 2.0, 3.0), 7.0
"""Of stops by a constant deceleration, and where nothing else is free."""
OFFSETS_M = (-0.6, -0.3, 0.0, 0.3, 0.6)
"""Distances from the route to arrive at: no map says whether another lane is free."""
LEAST_TURN_M, TURN_S = 10.0, 3.0
"""A change of the distance from the route takes so far at least, and so long at the speed now."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """C motions at `TIMES_S`: places along the route, speeds, accelerations and jerks along it, distances across it and their
    change by the distance driven, each (C, T); and poses in the world x, y, heading, with speeds, each (C, T)."""

    s_m: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    d_m: FloatArray
    slope: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    speed_m_s: FloatArray


@dataclass(frozen=True)
class Start:
    """The vehicle's rear axle along the route (place, speed, acceleration) and across it (distance and its change by the
    distance driven)."""

    along: State
    across: State

    @staticmethod
    def of(ego: EgoState, vehicle: Vehicle, route: Route) -> Start:
        """Return where the vehicle is on the route. A vehicle across the route counts as at 60 degrees to it."""
        s, d = route.project(ego.x_m, ego.y_m)
        _, _, heading, curvature = (float(one) for one in route.at(np.array(s)))
        turned = min(max(math.remainder(ego.heading_rad - heading, math.tau), -1.0), 1.0)
        room = max(1.0 - curvature * d, 0.2)
        slope = room * math.tan(turned)
        own = math.tan(ego.steering_rad) / vehicle.wheelbase_m
        bend = -curvature * slope * math.tan(turned) + room / math.cos(turned) ** 2 * (
            own * room / math.cos(turned) - curvature
        )
        ease = math.cos(turned) / room
        return Start((s, ego.speed_m_s * ease, ego.acceleration_m_s2 * ease), (d, slope, bend))


def candidates(start: Start, route: Route, wanted_m_s: float, stops_m: tuple[float, ...]) -> Candidates:
    """Return the motions that begin as the vehicle moves now; ``stops_m`` are places along the route to stop at."""
    along = _along(start.along, wanted_m_s, stops_m)
    across = quintic(
        start.across,
        np.array([[offset, 0.0, 0.0] for offset in OFFSETS_M]),
        np.full(len(OFFSETS_M), max(LEAST_TURN_M, TURN_S * start.along[1])),
    )
    length = max(LEAST_TURN_M, TURN_S * start.along[1])
    rows = list(itertools.product(range(len(along)), range(len(across))))
    of_along = np.array([row for row, _ in rows])
    s, rate, acceleration, jerk = (one[of_along] for one in np.moveaxis(along, 1, 0))
    driven = np.clip(s - start.along[0], 0.0, length)
    polynomial = across[np.array([column for _, column in rows])]
    d, slope = values(polynomial, driven), values(polynomial, driven, 1)
    slope = np.where(driven < length, slope, 0.0)
    x, y, heading, curvature = route.at(s)
    room = np.maximum(1.0 - curvature * d, 0.2)
    return Candidates(
        s, rate, acceleration, jerk, d, slope,
        x - d * np.sin(heading),
        y + d * np.cos(heading),
        heading + np.arctan2(slope, room),
        np.maximum(rate, 0.0) * np.hypot(room, slope),
    )  # fmt: skip


def _along(start: State, wanted_m_s: float, stops_m: tuple[float, ...]) -> FloatArray:
    """Motions (A, 4, T) along the route: places, speeds, accelerations, jerks."""
    pairs = np.array(list(itertools.product(SPEED_SHARES, DURATIONS_S)))
    polynomials, ends = quartic(start, pairs[:, 0] * wanted_m_s, pairs[:, 1]), pairs[:, 1]
    for stop in stops_m:
        ahead = stop - start[0]
        if ahead <= 0.1:
            continue
        # constant braking would take twice the distance by the speed
        usual = 2 * ahead / max(start[1], 1.0)
        durations = np.array([usual * share for share in (0.6, 0.75, 0.9, 1.1, 1.4)])
        durations = durations[(durations >= 0.5) & (durations <= 2 * HORIZON_S)]
        at = np.tile([stop, 0.0, 0.0], (len(durations), 1))
        polynomials = np.concatenate([polynomials, quintic(start, at, durations)])
        ends = np.concatenate([ends, durations])
    inside = np.minimum(TIMES_S, ends[:, None])
    after = TIMES_S - inside
    s, rate, acceleration, jerk = (values(polynomials, inside, order) for order in range(4))
    s = s + after * rate
    acceleration, jerk = (np.where(after > 0, 0.0, one) for one in (acceleration, jerk))
    late = [one for stop in stops_m for one in _late_stops(start, stop)]
    return np.concatenate(
        [np.stack([s, rate, acceleration, jerk], 1), *(one[None] for one in late), braking(start)[None]]
    )


def _late_stops(start: State, stop_m: float) -> list[FloatArray]:
    """Motions (4, T) that stop at a place by a constant deceleration, at once or as late as a harder one allows.

    A quintic brakes hardest at first: a vehicle that begins anew with one at every step would approach ever more slowly.
    """
    s, v, _ = start
    ahead = stop_m - s
    if ahead <= 0.1 or v <= 0.05:
        return []
    least = v * v / (2 * ahead)
    return [
        braking(start, deceleration, ahead - v * v / (2 * deceleration))
        for deceleration in (least, *(one for one in DECELERATIONS_M_S2 if one > least))
    ]


def braking(start: State, deceleration_m_s2: float = HARDEST_M_S2, after_m: float = 0.0) -> FloatArray:
    """Return the motion (4, T) along the route that brakes at a constant deceleration, at a constant speed before that."""
    s, v, _ = start
    begins = after_m / max(v, 1e-3)
    free = np.minimum(TIMES_S, begins)
    t = np.clip(TIMES_S - begins, 0.0, v / deceleration_m_s2)
    brakes = (begins <= TIMES_S) & (v - deceleration_m_s2 * t > 0)
    return np.stack(
        [
            s + v * (free + t) - deceleration_m_s2 / 2 * t**2,
            v - deceleration_m_s2 * t,
            np.where(brakes, -deceleration_m_s2, 0.0),
            np.zeros_like(t),
        ]
    )
