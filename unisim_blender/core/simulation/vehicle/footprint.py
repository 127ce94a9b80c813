"""The vehicle seen from above."""

from __future__ import annotations

import math

from ..states import EGO, EgoState, Footprint
from .parameters import Vehicle

LABEL = "Car"
"""The ego vehicle's class."""


def footprint_of(state: EgoState, vehicle: Vehicle) -> Footprint:
    """Return the vehicle's box seen from above: its centre lies ahead of the rear axle, by half its length less the rear
    overhang."""
    ahead = vehicle.length_m / 2 - vehicle.rear_overhang_m
    return Footprint(
        uid=EGO,
        label=LABEL,
        x_m=state.x_m + ahead * math.cos(state.heading_rad),
        y_m=state.y_m + ahead * math.sin(state.heading_rad),
        heading_rad=state.heading_rad,
        length_m=vehicle.length_m,
        width_m=vehicle.width_m,
        speed_m_s=state.speed_m_s,
        acceleration_m_s2=state.acceleration_m_s2,
    )
