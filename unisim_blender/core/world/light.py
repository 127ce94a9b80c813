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
EARTH_M = 6378137.0


def direction_to(azimuth: float, elevation: float) -> FloatArray:
    """Return a unit direction (3,), world frame, by angles in radians."""
    along = np.cos(elevation)
    return np.array([along * np.cos(azimuth), along * np.sin(azimuth), np.sin(elevation)])


@dataclass(frozen=True)
class SunPosition:
    """Where the sun stood in a recording, world frame, and the standard deviation of its direction, all in degrees."""

    azimuth_deg: float
    elevation_deg: float
    deviation_deg: float


FORMULA_DEG = 0.3
"""Error of the formula of `sun_over`, with refraction."""
LEAST_TRAVEL_M = 10.0
"""Distance driven from which positions tell where east is."""


def sun_over(latitude_deg: float, longitude_deg: float, utc_s: float) -> tuple[float, float]:
    """Return azimuth, counter-clockwise from east, and elevation of the sun, degrees, at a time in seconds since 1970. The
    Astronomical Almanac's low-precision formulas (Michalsky 1988)."""
    days = utc_s / 86400 - 10957.5  # from noon of 1 January 2000
    mean, anomaly = np.radians(280.460 + 0.9856474 * days), np.radians(357.528 + 0.9856003 * days)
    longitude = mean + np.radians(1.915) * np.sin(anomaly) + np.radians(0.020) * np.sin(2 * anomaly)
    tilt = np.radians(23.439 - 4e-7 * days)
    ascension = np.arctan2(np.cos(tilt) * np.sin(longitude), np.cos(longitude))
    declination = np.arcsin(np.sin(tilt) * np.sin(longitude))
    sidereal = np.radians(15 * (18.697374558 + 24.06570982441908 * days) + longitude_deg)
    hour, latitude = sidereal - ascension, np.radians(latitude_deg)
    east = -np.cos(declination) * np.sin(hour)
    north = np.sin(declination) * np.cos(latitude) - np.cos(declination) * np.sin(latitude) * np.cos(hour)
    up = np.sin(declination) * np.sin(latitude) + np.cos(declination) * np.cos(latitude) * np.cos(hour)
    return float(np.degrees(np.arctan2(north, east))), float(np.degrees(np.arcsin(up)))


def recorded_sun(degrees: FloatArray, positions: FloatArray, utc_s: float) -> SunPosition | None:
    """Return where the sun stood at a time, by latitudes and longitudes (N, 2) at positions (N, 3), world frame, that tell
    how the world is turned; None where those lie too close together, or the sun was down."""
    north, east = np.radians(degrees - degrees.mean(0)).T * EARTH_M
    east = east * np.cos(np.radians(degrees[:, 0].mean()))
    there = (east - east.mean()) + 1j * (north - north.mean())
    here = (positions[:, 0] - positions[:, 0].mean()) + 1j * (positions[:, 1] - positions[:, 1].mean())
    azimuth, elevation = sun_over(float(degrees[:, 0].mean()), float(degrees[:, 1].mean()), utc_s)
    if min(np.ptp(np.abs(x - x[0])) for x in (there, here)) < LEAST_TRAVEL_M or elevation <= 0:
        return None
    turn = np.vdot(there, here)
    turn /= abs(turn)
    spread = float(np.degrees(np.sqrt(np.mean(np.abs(here - turn * there) ** 2) / np.mean(np.abs(there) ** 2))))
    turned = np.angle(turn * np.exp(1j * np.radians(azimuth)), deg=True)
    return SunPosition(float(turned), elevation, float(np.hypot(spread, FORMULA_DEG)))


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
