"""Names of sensors: as a scenario has them, such that no other one has; and names of rig presets."""

from __future__ import annotations

import re
from collections.abc import Container

from ...core.errors import ScenarioError
from ...core.world.drive import Drive
from ..sampled.scene import SampledObject

LONGEST_NAME = 60
"""Letters of a rig preset's name."""


def free_name(wanted: str, taken: Container[str]) -> str:
    """Return ``wanted``, or that name with a number behind it that is not taken."""
    name, number = wanted, 2
    while name in taken:
        name, number = f"{wanted}_{number}", number + 1
    return name


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
    """What a scenario calls a sensor: as the log does, or after the object; names of files are made of it."""
    return sensor_name(obj.title, obj.uid, obj.is_original, drive)


def sensor_name(title: str, uid: str, is_original: bool, drive: Drive) -> str:
    """Return a scenario's name of a sensor: the id in the log where it is an original, else one made of its title."""
    recorded = uid in drive.cameras or uid in drive.lidars
    return uid if recorded and is_original else safe_name(title)


def safe_name(text: str) -> str:
    """A name of a sensor that a file's name can be made of."""
    return re.sub(r"[^A-Za-z0-9_.-]|^[.-]", "_", text)
