"""Weather: its parameters over time, and at one moment. Cameras and LiDARs read the same ones (`core/weather/`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

WETTING_MM_H = 2.0
"""Rate of rain that leaves a part 1/e of the ground dry."""
AS_RECORDED_DEG, LAMPS_DEG = 90.0, 3.0
"""Elevation of the sun that stands for the recorded light, and the one below which lamps are on."""


@dataclass(frozen=True)
class Receiver:
    """What cameras and LiDARs lack in their models: ``pulse_ns``, the half-power width of a LiDAR's pulse;
    ``divergence_mrad``, the full angle of its beams; ``threshold``, the reflectivity of the darkest target that it
    measures at its largest range in clear air; ``overlap_m``, the distance from which its receiver sees all of a beam's
    light; ``exposure_s``, how long a camera's pixel is exposed."""

    pulse_ns: float = 10.0
    divergence_mrad: float = 3.0
    threshold: float = 0.1
    overlap_m: float = 8.0
    exposure_s: float = 0.005


@dataclass(frozen=True)
class Weather:
    """The weather at one moment: ``visibility_m``, inf without fog; ``rain_mm_h`` and ``snow_mm_h`` of liquid water;
    ``wetness`` of the ground, 0 to 1, to which rain adds; ``seed`` of the particles and of random draws. Images look as if
    the sun stood ``sun_elevation_deg`` high; at `AS_RECORDED_DEG` as they were recorded. ``street_lamps``: x and y of a
    lamp, world frame, and its height above the ground there, metres; on below `LAMPS_DEG`."""

    visibility_m: float = math.inf
    rain_mm_h: float = 0.0
    snow_mm_h: float = 0.0
    wetness: float = 0.0
    seed: int = 0
    receiver: Receiver = Receiver()
    sun_elevation_deg: float = AS_RECORDED_DEG
    street_lamps: tuple[tuple[float, float, float], ...] = ()

    @property
    def is_clear(self) -> bool:
        """Whether an image is what it is without weather."""
        return self.is_clear_of_water and self.sun_elevation_deg >= AS_RECORDED_DEG

    @property
    def is_clear_of_water(self) -> bool:
        """Whether a sweep is what it is without weather."""
        return math.isinf(self.visibility_m) and not (self.rain_mm_h or self.snow_mm_h or self.wetness)

    @property
    def reaches_far(self) -> bool:
        """Whether what is out of an image's view may change it: reflections, spray and the light of lamps."""
        return self.wet > 0 or self.sun_elevation_deg < LAMPS_DEG

    @property
    def wet(self) -> float:
        """Part of the ground that a film of water covers, 0 to 1."""
        return 1 - (1 - self.wetness) * math.exp(-self.rain_mm_h / WETTING_MM_H)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form; visibility is None without fog, and lamps are a member where there are any."""
        values = {**asdict(self), "visibility_m": None if math.isinf(self.visibility_m) else self.visibility_m}
        lamps = values.pop("street_lamps")
        return {**values, "street_lamps": [list(lamp) for lamp in lamps]} if lamps else values

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Weather:
        """Return the weather of `to_dict`. Raises TypeError for other members."""
        visibility, receiver = values["visibility_m"], Receiver(**values["receiver"])
        lamps = tuple((float(x), float(y), float(height_m)) for x, y, height_m in values.get("street_lamps", ()))
        visibility = math.inf if visibility is None else visibility
        return Weather(**{**values, "visibility_m": visibility, "receiver": receiver, "street_lamps": lamps})


KEYED = ("visibility_m", "rain_mm_h", "snow_mm_h", "wetness", "sun_elevation_deg")
"""Members of `Weather` that change over time."""


@dataclass(frozen=True)
class WeatherKeys:
    """Weather over time: for each of `KEYED` that is there, keys (time in seconds, value) in order, linear between them
    and constant beyond; a visibility's reciprocal is linear, as the density of fog is. ``constant`` is all else."""

    keys: Mapping[str, tuple[tuple[float, float], ...]]
    constant: Weather = field(default_factory=Weather)

    def at(self, time_s: float) -> Weather | None:
        """Return the weather at a time, seconds; None where it changes nothing."""
        values: dict[str, Any] = {name: self.value(name, time_s) for name in self.keys}
        weather = replace(self.constant, **values)
        if weather.sun_elevation_deg >= LAMPS_DEG:
            weather = replace(weather, street_lamps=())
        return None if weather.is_clear else weather

    def value(self, name: str, time_s: float) -> float:
        """Return one of `KEYED` that is there, at a time, seconds."""
        times, values = np.array(self.keys[name]).T
        if name != "visibility_m":
            return float(np.interp(time_s, times, values))
        density = float(np.interp(time_s, times, 1 / values))
        return 1 / density if density else math.inf

    def to_json(self) -> dict[str, Any]:
        """Return the JSON form: two are equal exactly where it is."""
        keys = {name: [list(key) for key in keys] for name, keys in sorted(self.keys.items())}
        return {"keys": keys, "constant": self.constant.to_dict()}
