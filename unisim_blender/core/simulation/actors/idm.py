"""The Intelligent Driver Model: how hard a driver accelerates behind another.

Source: Treiber, Hennecke and Helbing, "Congested traffic states in empirical observations and microscopic simulations",
Phys. Rev. E 62, 2000; the desired gap's lower bound is that of Treiber and Kesting, "Traffic Flow Dynamics", 2013, eq. 11.14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

LEAST_DESIRED_M_S = 0.01
"""Desired speeds below this count as this, so that nothing is divided by zero."""
LEAST_GAP_M = 0.01


@dataclass(frozen=True)
class IdmParameters:
    """Parameters of the model; the defaults are nuPlan's. ``braking_m_s2`` is the comfortable deceleration."""

    headway_s: float = 1.5
    gap_m: float = 1.0
    acceleration_m_s2: float = 1.0
    braking_m_s2: float = 2.0
    exponent: float = 4.0

    def free_acceleration(self, speed_m_s: float, desired_m_s: float) -> float:
        """Return the acceleration (m/s²) on a free road."""
        ratio = max(speed_m_s, 0.0) / max(desired_m_s, LEAST_DESIRED_M_S)
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
