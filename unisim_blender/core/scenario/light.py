"""Light of a scenario's document: the sun, in numbers or keys over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ..world.light import KEYED, MAX_STRENGTH, SunKeys
from .json_schema import Schema, object_of
from .weather import Keyed, check_keys, keyed, keys_of

MIN_ELEVATION_DEG = 2.0


@dataclass(frozen=True)
class SunSpec:
    """The sun, by which changed actors cast shadows; each value is a number, or a list of keys over time."""

    azimuth_deg: Annotated[
        Keyed, keyed("Direction to the sun, counter-clockwise from the world's x.", minimum=-360, maximum=360)
    ]
    elevation_deg: Annotated[Keyed, keyed("Height above the horizon.", minimum=MIN_ELEVATION_DEG, maximum=90)]
    strength: Annotated[
        Keyed, keyed("The sun's part of the light on sunlit level ground; 0: none.", minimum=0, maximum=MAX_STRENGTH)
    ]


@dataclass(frozen=True)
class LightSpec:
    """Light of what edits change."""

    sun: SunSpec


DEFS: dict[str, Schema] = {
    "light": object_of(LightSpec, "Light of what edits change, in cameras."),
    "sun": object_of(SunSpec),
}


def check_light(spec: LightSpec, place: str) -> None:
    """Raise `ScenarioError` for keys that are not in order."""
    check_keys(spec.sun, KEYED, f"{place}.sun")


def sun_of(spec: LightSpec) -> SunKeys:
    """Return the sun that a document states."""
    return SunKeys(keys_of(spec.sun, KEYED))
