"""Target that a scenario is applied to."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ....core.scenario.types import Scenario
from ....core.world.drive import Drive
from ....editing.sampled.clock import Clock
from ...objects.imported import imported_objects


@dataclass(frozen=True)
class Target:
    """A freshly imported scene, its drive, and the drive that the scenario's edits lead to."""

    scene: bpy.types.Scene
    recorded: Drive
    scenario: Scenario
    edited: Drive
    clock: Clock

    @property
    def ego(self) -> bpy.types.Object:
        """The vehicle's object."""
        return next(imported_objects(self.scene, "EGO"))
