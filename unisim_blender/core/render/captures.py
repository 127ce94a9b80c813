"""What each capture of a drive depends on: the state of the world that its sensor can see."""

from __future__ import annotations

from dataclasses import dataclass

from ..sensors.exposure import exposure_window
from ..world.drive import Camera, Lidar
from ..world.state import StateSource, WorldState
from .visibility import Reach, seen_by


@dataclass(frozen=True)
class CaptureStates:
    """The states that captures depend on. ``sees_all``: whether a frame depends on actors out of its view, too."""

    states: StateSource
    reach: Reach
    sees_all: bool = False

    def state(self, sensor: Camera | Lidar, time_s: float) -> WorldState:
        """Return the state that a sensor's frame at ``time_s``, seconds, depends on."""
        state = self.states.state(*exposure_window(sensor, time_s))
        return state if self.sees_all else seen_by(state, sensor, self.reach)
