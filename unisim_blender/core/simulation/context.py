"""What does not change during a simulation: the recorded drive, the vehicle, the actors' models, the sensors' exposures."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from ..geometry import FloatArray
from ..world.drive import Drive
from .actors.model import ActorModel
from .actors.recording import Recording
from .clock import Exposure
from .states import EgoState, Footprint
from .vehicle.ground import Heights
from .vehicle.parameters import Vehicle

PosesOf = Callable[[Sequence[EgoState]], FloatArray]
"""Gives the poses (N, 4, 4) of the log's ego frame: height, roll and pitch are the ground's."""


@dataclass(frozen=True, eq=False)
class SimulationContext:
    """Where a simulation happens, from ``start_us`` to ``stop_us`` in steps of ``step_us``, integer microseconds.

    ``drive`` is the scenario's, with its edits. ``models`` are the actors' by identifier; ``moved`` names those that the
    simulation moves, the others are where the drive has them. An action takes effect ``delay_us`` after the moment that it
    answers. ``exposures`` are in the order of their ends.
    """

    drive: Drive
    recording: Recording
    vehicle: Vehicle
    poses_of: PosesOf
    heights: Heights
    models: Mapping[str, ActorModel]
    moved: frozenset[str]
    exposures: tuple[Exposure, ...]
    start_us: int
    stop_us: int
    step_us: int
    delay_us: int = 0

    @cached_property
    def standing(self) -> tuple[Footprint, ...]:
        """The boxes of what stands as long as it is recorded and has no model."""
        return tuple(one for one in self.recording.standing.footprints if one.uid not in self.models)

    @cached_property
    def _ends(self) -> list[int]:
        return [one.end_us for one in self.exposures]

    @cached_property
    def _longest_us(self) -> int:
        return max((one.end_us - one.start_us for one in self.exposures), default=0)

    def ended(self, after_us: int, until_us: int) -> list[Exposure]:
        """Return the exposures that end after one time and not after another."""
        first, last = (bisect_left(self._ends, time_us + 1) for time_us in (after_us, until_us))
        return list(self.exposures[first:last])

    def during(self, start_us: int, stop_us: int) -> list[Exposure]:
        """Return the exposures of which some part lies between two times."""
        first, last = bisect_left(self._ends, start_us), bisect_left(self._ends, stop_us + self._longest_us + 1)
        return [one for one in self.exposures[first:last] if one.start_us <= stop_us]
