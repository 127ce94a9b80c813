"""Boxes of space that edits of what carries no annotation name."""

from __future__ import annotations

import numpy as np

from ..world.drive import Box
from .faults import fail, listed
from .motion.placement import BoxSpec, pose_of
from .types import Scenario


def check_box(key: str, scenario: Scenario, place: str) -> None:
    """Raise `ScenarioError` where the scenario has no such box."""
    if key not in (scenario.boxes or {}):
        fail(f"{place}.box", f'no box "{key}" {listed(scenario.boxes or {})}')


def box_of(key: str, scenario: Scenario) -> Box:
    """The box of a checked scenario as a pose and a size."""
    box: BoxSpec = (scenario.boxes or {})[key]
    return Box(pose_of(box), np.array(box.size_m, float))
