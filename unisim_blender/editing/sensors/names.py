"""Names of sensors: as a scenario has them, such that no other one has, and of rig presets; and what a list of sensors
says of each: resolution or beams, rate, where it is mounted, what became of it."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import lru_cache

from ...core.errors import ScenarioError
from ...core.rigs import Rig
from ...core.world.drive import Drive
from ..sampled.clock import Clock
from ..sampled.scene import SampledObject
from ..texts import counted, series

LONGEST_NAME = 60
"""Letters of a rig preset's name."""


def preset_name(name: str) -> str:
    """Return a rig preset's name without spaces around it. Raises `ScenarioError` where no file can have it."""
    name = name.strip()
    odd = sorted({letter for letter in name if not (letter.isalnum() or letter in " _-.()+")})
    if not name or name.startswith(".") or len(name) > LONGEST_NAME or odd:
        raise ScenarioError(
            f'name "{name}": a preset\'s name has 1 to {LONGEST_NAME} letters, digits, spaces and _-.()+ and begins with no dot'
        )
    return name


def sensor_id(obj: SampledObject, drive: Drive) -> str:
    """Return a sensor's name in a scenario: the log's, or one after the object; names of files are made of it."""
    return sensor_name(obj.title, obj.uid, obj.is_original, drive)


def sensor_name(title: str, uid: str, is_original: bool, drive: Drive) -> str:
    """Return a scenario's name of a sensor: the id in the log where it is an original, else one made of its title."""
    recorded = uid in drive.cameras or uid in drive.lidars
    return uid if recorded and is_original else safe_name(title)


def safe_name(text: str) -> str:
    """A name of a sensor that a file's name can be made of."""
    return re.sub(r"[^A-Za-z0-9_.-]|^[.-]", "_", text)


@dataclass(frozen=True)
class SensorCard:
    """Description of one sensor: ``view``, its angle or range; ``mount``, where on the vehicle; ``state``, what became
    of it. What only the drive tells is "" where that is not at hand."""

    view: str
    mount: str
    state: str


def rate_of(drive: Drive | None) -> str:
    """Return how often a sensor measures: once a frame of the log."""
    return "" if drive is None else f"{Clock.of(drive).rate:.3g} Hz"


@lru_cache(maxsize=64)
def beams_of(text: str) -> tuple[int, float]:
    """Return the number of a LiDAR's beams, and its range in metres."""
    values = json.loads(text)
    return len(values["elevation_rad"]), float(values["max_range_m"])


def rig_contents(rig: Rig) -> str:
    """Return how many cameras and LiDARs a rig has, in words."""
    cameras = counted(len(rig.cameras), "1 camera", "{count} cameras")
    return series([cameras, counted(len(rig.lidars), "1 LiDAR", "{count} LiDARs")])
