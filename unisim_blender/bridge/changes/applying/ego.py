"""The vehicle of an edited drive in an imported scene."""

from __future__ import annotations

from ...importing.drive import animate
from .target import Target


def apply_ego(target: Target) -> None:
    """Let the vehicle drive elsewhere."""
    if target.edited.world_from_ego is not target.recorded.world_from_ego:
        animate(target.ego, target.edited.world_from_ego, target.clock)
