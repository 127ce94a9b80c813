"""The sun of a drive: where it stands and how strong it is, over time, and at one moment beside what an edit has changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..geometry import FloatArray
from ..json_file import Node

DAYLIGHT = (1.04, 1.0, 0.96)
"""Strengths of red, green and blue relative to their mean: the sky's light is bluer."""
MAX_STRENGTH = 0.98


def direction_to(azimuth: float, elevation: float) -> FloatArray:
    """Return a unit direction (3,), world frame, by angles in radians."""
    along = np.cos(elevation)
    return np.array([along * np.cos(azimuth), along * np.sin(azimuth), np.sin(elevation)])


@dataclass(frozen=True)
class Sun:
    """The sun at one moment. ``azimuth_deg`` is counter-clockwise from the world's x, ``elevation_deg`` above the
    horizon; ``strength`` (3,): the sun's part of the light, linear RGB, on level ground that it shines on."""

    azimuth_deg: float
    elevation_deg: float
    strength: tuple[float, float, float]

    @property
    def direction(self) -> FloatArray:
        """Unit direction (3,) to the sun, world frame."""
        return direction_to(np.radians(self.azimuth_deg), np.radians(self.elevation_deg))

    @property
    def casts(self) -> bool:
        """Whether it casts shadows."""
        return max(self.strength) > 0

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "strength": list(self.strength)}

    @staticmethod
    def from_json(node: Node) -> Sun:
        """Return the sun of `to_json`. Raises the node's error."""
        red, green, blue = node.key("strength").array(3).tolist()
        return Sun(node.key("azimuth_deg").number(), node.key("elevation_deg").number(), (red, green, blue))


KEYED = ("azimuth_deg", "elevation_deg", "strength")
"""Members of `Sun` that change over time; of the strength its mean."""


@dataclass(frozen=True)
class SunKeys:
    """The sun over time: for each of `KEYED`, keys (time in seconds, value) in order, linear between them and constant
    beyond."""

    keys: Mapping[str, tuple[tuple[float, float], ...]]

    def at(self, time_s: float) -> Sun:
        """Return the sun at a time, seconds."""
        values = {name: float(np.interp(time_s, *np.array(keys).T)) for name, keys in self.keys.items()}
        red, green, blue = np.clip(values["strength"] * np.array(DAYLIGHT), 0, MAX_STRENGTH).tolist()
        return Sun(values["azimuth_deg"], values["elevation_deg"], (red, green, blue))

    def to_json(self) -> dict[str, Any]:
        """Return the JSON form: two are equal exactly where it is."""
        return {name: [list(key) for key in keys] for name, keys in sorted(self.keys.items())}


@dataclass(frozen=True)
class Sunlight:
    """The sun over an exposure, and the ids of actors that an edit has inserted or changed: the light of all else, but
    for what was removed, is the recorded one."""

    sun: Sun
    changed: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"sun": self.sun.to_json(), "changed": list(self.changed)}

    @staticmethod
    def from_json(node: Node) -> Sunlight:
        """Return the light of `to_json`. Raises the node's error."""
        return Sunlight(Sun.from_json(node.key("sun")), tuple(child.text() for child in node.key("changed").elements()))
