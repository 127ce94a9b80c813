"""The Intelligent Driver Model, and a vehicle along a path that keeps its distance by it and goes neither backward nor aside.

Source: Treiber, Hennecke and Helbing, "Congested traffic states in empirical observations and microscopic simulations",
Phys. Rev. E 62, 2000; the desired gap's lower bound is that of Treiber and Kesting, "Traffic Flow Dynamics", 2013, eq. 11.14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from ...scenario.json_schema import Schema, SchemaOf
from ...world.actor_path import STOP_TOLERANCE_M, ActorPath
from ...world.captures import US_PER_SECOND
from ..states import ActorState
from .lead import Lead, Search

DIVISOR_FLOOR_M_S = 0.01
"""Desired speeds below this count as this, so that nothing is divided by zero."""
LEAST_GAP_M = 0.01

ACCELERATION: Schema = {"type": "number", "exclusiveMinimum": 0, "maximum": 50}


@dataclass(frozen=True)
class IdmParameters:
    """Parameters of the model; the defaults are nuPlan's. ``braking_m_s2`` is the comfortable deceleration."""

    headway_s: Annotated[float, SchemaOf({"type": "number", "minimum": 0, "maximum": 20})] = 1.5
    gap_m: Annotated[float, SchemaOf({"type": "number", "exclusiveMinimum": 0, "maximum": 100})] = 1.0
    acceleration_m_s2: Annotated[float, SchemaOf(ACCELERATION)] = 1.0
    braking_m_s2: Annotated[float, SchemaOf(ACCELERATION)] = 2.0
    exponent: Annotated[float, SchemaOf({"type": "number", "minimum": 1, "maximum": 20})] = 4.0

    def free_acceleration(self, speed_m_s: float, desired_m_s: float) -> float:
        """Return the acceleration (m/s²) on a free road."""
        ratio = max(speed_m_s, 0.0) / max(desired_m_s, DIVISOR_FLOOR_M_S)
        return float(self.acceleration_m_s2 * (1 - ratio**self.exponent))

    def desired_gap(self, speed_m_s: float, lead_m_s: float) -> float:
        """Return the gap (m) that is kept behind a lead, never less than the gap at rest."""
        closing = speed_m_s * (speed_m_s - lead_m_s) / (2 * math.sqrt(self.acceleration_m_s2 * self.braking_m_s2))
        return self.gap_m + max(speed_m_s * self.headway_s + closing, 0.0)

    def interaction(self, speed_m_s: float, gap_m: float, lead_m_s: float) -> float:
        """Return the deceleration (m/s², positive) for a lead. A gap of `LEAST_GAP_M` stands for all that are less."""
        ratio = self.desired_gap(speed_m_s, lead_m_s) / max(gap_m, LEAST_GAP_M)
        return self.acceleration_m_s2 * ratio * ratio

    def acceleration(
        self, speed_m_s: float, desired_m_s: float, gap_m: float | None = None, lead_m_s: float = 0.0
    ) -> float:
        """Return the model's acceleration (m/s²), which has no lower bound; ``gap_m`` is None on a free road."""
        free = self.free_acceleration(speed_m_s, desired_m_s)
        return free if gap_m is None else free - self.interaction(speed_m_s, gap_m, lead_m_s)


HARDEST_M_S2 = 8.0
"""No vehicle brakes harder, whatever the model says."""
LEAST_DESIRED_M_S = 1.0
"""Where the recording was slower, this speed is wanted: at the recorded one, a vehicle would never leave where it stood."""
LONGEST_US = 50_000
"""Steps are divided into parts of at most this."""
SEEN_M, FURTHEST_M = 10.0, 300.0
"""How far beyond its braking distance a driver looks, and how far at most."""


@dataclass(frozen=True)
class PathProgress:
    """How far along a path a vehicle is, and how fast."""

    path: ActorPath
    s_m: float
    speed_m_s: float
    acceleration_m_s2: float = 0.0
    ignored: frozenset[str] = frozenset()
    """Boxes that are in the way of the path in the recording already, where labels overlap."""
    least_m_s: float = LEAST_DESIRED_M_S
    """The least speed that is wanted."""

    @property
    def is_over(self) -> bool:
        """Whether the path's actor has left the world."""
        return self.path.ends and self.s_m > self.path.length_m + 1e-6

    def state(self) -> ActorState:
        """Return the state there; absent beyond the end of a path whose actor leaves the world at it."""
        position, quaternion = self.path.place(self.s_m)
        speed = self.speed_m_s if self.path.gear_at(self.s_m) > 0 else 0.0
        return ActorState(position, quaternion, speed, self.acceleration_m_s2, not self.is_over)


def search_of(progress: PathProgress, driver: IdmParameters, size_m: tuple[float, float], uid: str) -> Search:
    """Return the search for what is in the way, as far as the driver looks: beyond the gap wanted behind one that stands."""
    length, width = size_m
    horizon = min(SEEN_M + 1.5 * driver.desired_gap(progress.speed_m_s, 0.0), FURTHEST_M)
    step = min(max(length / 3, 0.25), 1.5)
    return Search(progress.path, progress.s_m, horizon, step, uid, length, width, progress.ignored)


def advanced(
    progress: PathProgress, driver: IdmParameters, lead: Lead | None, time_us: int, step_us: int
) -> PathProgress:
    """Return the progress after a step in which the lead keeps its speed.

    The speed is linear in each part of the step (Treiber and Kanagaraj, "Comparing numerical integration schemes for
    time-continuous car-following models", 2015), and a vehicle that comes to rest stays there. What is above the desired
    speed brakes comfortably, not by the model's fourth power.
    """
    path, s, speed = progress.path, progress.s_m, progress.speed_m_s
    count = -(-step_us // LONGEST_US)
    dt = step_us / count / US_PER_SECOND
    for part in range(count):
        desired = max(path.speed_at(s), progress.least_m_s)
        wanted = max(driver.free_acceleration(speed, desired), -driver.braking_m_s2)
        hindrance = 0.0
        if lead is not None:
            gap = lead.gap_m - (s - progress.s_m) + lead.speed_m_s * part * dt
            hindrance = driver.interaction(speed, gap, lead.speed_m_s)
        now_s = time_us / US_PER_SECOND + part * dt
        to_stop = next(
            (stop.s_m - s for stop in path.stops if stop.s_m >= s - STOP_TOLERANCE_M and stop.leave_s > now_s), None
        )
        if to_stop is not None:  # as if a box stood where this one's front comes to rest
            hindrance = max(hindrance, driver.interaction(speed, to_stop + driver.gap_m, 0.0))
        acceleration = max(wanted - hindrance, -HARDEST_M_S2)
        after = speed + acceleration * dt
        if after > 0:
            s += (speed + after) / 2 * dt
            speed = after
        else:
            s += speed * speed / (2 * -acceleration) if acceleration < 0 else 0.0
            speed = 0.0
    changed = (speed - progress.speed_m_s) * US_PER_SECOND / step_us
    if not math.isfinite(s + speed):
        raise ValueError(f"progress at {s} m and {speed} m/s is not finite")
    return PathProgress(path, s, speed, changed, progress.ignored, progress.least_m_s)
