"""What a list of sensors says of each: resolution or beams, rate, where it is mounted, what became of it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache

from ...core.rigs import Rig
from ...core.world.drive import Drive
from ..sampled.clock import Clock
from ..texts import counted, series


@dataclass(frozen=True)
class SensorCard:
    """What is said of one sensor: ``view``, its angle or range; ``mount``, where on the vehicle; ``state``, what became
    of it. What only the drive tells is "" where that is not at hand."""

    view: str
    mount: str
    state: str


def rate_of(drive: Drive | None) -> str:
    """Return how often a sensor measures: once a frame of the log."""
    return "" if drive is None else f"{Clock.of(drive).rate:.3g} Hz"


@lru_cache(maxsize=64)
def beams_of(text: str) -> tuple[int, float]:
    """How many beams a LiDAR's table has, and its range in metres."""
    values = json.loads(text)
    return len(values["elevation_rad"]), float(values["max_range_m"])


def rig_contents(rig: Rig) -> str:
    """Return how many cameras and LiDARs a rig has, in words."""
    cameras = counted(len(rig.cameras), "1 camera", "{count} cameras")
    return series([cameras, counted(len(rig.lidars), "1 LiDAR", "{count} LiDARs")])
