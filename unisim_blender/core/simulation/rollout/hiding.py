"""Sensors that do not see some of the actors. Physics, scores and other actors know nothing of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace

from ...errors import SimulationError
from ...world.drive import Drive
from ..clock import Exposure
from ..observations import CameraImage, LidarSweep
from .sensors import SensorSource


@dataclass
class HiddenActors:
    """Delivers what ``sensors`` do, without the actors that are ``hidden`` from them: identifiers by the sensor's name.

    A rollout's scenario cannot say what was hidden: `finish` would render these captures anew, with the actors.
    """

    sensors: SensorSource
    hidden: Mapping[str, AbstractSet[str]]
    unsupported: dict[str, float] = field(default_factory=dict)

    def render(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """See `SensorSource.render`. Raises `SimulationError` for a sensor or an actor that the drive does not have."""
        return self._delivered(drive, exposures, renders=True)

    def read(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """See `SensorSource.read`."""
        return self._delivered(drive, exposures, renders=False)

    def _delivered(
        self, drive: Drive, exposures: Sequence[Exposure], renders: bool
    ) -> tuple[list[CameraImage], list[LidarSweep]]:
        for name, uids in self.hidden.items():
            if name not in drive.cameras and name not in drive.lidars:
                raise SimulationError(f'hidden actors: there is no sensor "{name}"')
            for uid in uids - drive.actors.keys():
                raise SimulationError(f'hidden actors: there is no actor "{uid}" to hide from {name}')
        images, sweeps = [], []
        unsupported: dict[str, float] = {}
        for one in exposures:
            seen = without(drive, self.hidden.get(one.capture.sensor_id, frozenset()))
            found = self.sensors.render(seen, [one]) if renders else self.sensors.read(seen, [one])
            images += found[0]
            sweeps += found[1]
            unsupported |= self.sensors.unsupported
        self.unsupported = unsupported
        return images, sweeps


def without(drive: Drive, uids: AbstractSet[str]) -> Drive:
    """Return a drive without some of its actors."""
    if not uids:
        return drive
    return replace(drive, actors={uid: actor for uid, actor in drive.actors.items() if uid not in uids})
