"""The sun of a drive: where it stands and how strong it is, over time, and at one moment beside what an edit has changed;
and where it shines on the ground of a recording."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..json_file import Node

DAYLIGHT = (1.04, 1.0, 0.96)
"""Strengths of red, green and blue relative to their mean, where no recording tells them: the sky's light is bluer."""
MAX_STRENGTH = 0.98


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
        azimuth, elevation = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        along = np.cos(elevation)
        return np.array([along * np.cos(azimuth), along * np.sin(azimuth), np.sin(elevation)])

    @property
    def casts(self) -> bool:
        """Whether it casts shadows."""
        return max(self.strength) > 0

    def with_strength(self, mean: float) -> Sun:
        """Return the sun with another mean strength, of the same colour."""
        now = float(np.mean(self.strength))
        colour = np.array(self.strength) / now if now > 0 else np.array(DAYLIGHT)
        red, green, blue = np.clip(mean * colour, 0, MAX_STRENGTH).tolist()
        return replace(self, strength=(red, green, blue))

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
    """The sun over time: ``recorded``, and for each of `KEYED` that is there, keys (time in seconds, value) in order in
    place of its own, linear between them and constant beyond."""

    recorded: Sun
    keys: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)

    def at(self, time_s: float) -> Sun:
        """Return the sun at a time, seconds."""
        values = {name: float(np.interp(time_s, *np.array(keys).T)) for name, keys in self.keys.items()}
        strength = values.pop("strength", None)
        sun = replace(self.recorded, **values)  # type: ignore[arg-type]
        return sun if strength is None else sun.with_strength(strength)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON form: two are equal exactly where it is."""
        keys = {name: [list(key) for key in keys] for name, keys in sorted(self.keys.items())}
        return {"recorded": self.recorded.to_json(), "keys": keys}


@dataclass(frozen=True)
class Light:
    """The sun over an exposure, and the ids of actors that an edit has inserted or changed: the light of all else, but
    for what was removed, is the recorded one."""

    sun: Sun
    changed: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"sun": self.sun.to_json(), "changed": list(self.changed)}

    @staticmethod
    def from_json(node: Node) -> Light:
        """Return the light of `to_json`. Raises the node's error."""
        return Light(Sun.from_json(node.key("sun")), tuple(child.text() for child in node.key("changed").elements()))


@dataclass(frozen=True)
class SunlitGround:
    """Where the sun shone on the ground, were no actor there: ``lit`` (X, Y) bool of cells of ``cell_m``, the first at
    ``corner`` (2,), world frame."""

    corner: FloatArray
    cell_m: float
    lit: NDArray[np.bool_]

    def at(self, points: FloatArray) -> FloatArray:
        """Return how sunlit (N,) in 0..1 the ground at points (N, 3), world frame, is: bilinear, and beyond the cells as
        at their edge."""
        last = np.array(self.lit.shape) - 1
        place = np.clip((points[:, :2] - self.corner) / self.cell_m - 0.5, 0, last)
        low = np.floor(place).astype(np.int64)
        (x, y), (x1, y1), (u, v) = low.T, np.minimum(low + 1, last).T, (place - low).T
        lit = self.lit.astype(np.float64)
        near, far = lit[x, y] * (1 - v) + lit[x, y1] * v, lit[x1, y] * (1 - v) + lit[x1, y1] * v
        return np.asarray(near * (1 - u) + far * u)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        cells = base64.b64encode(zlib.compress(np.packbits(self.lit).tobytes(), 9)).decode()
        return {
            "corner": self.corner.tolist(), "cell_m": self.cell_m, "shape": list(self.lit.shape), "cells": cells,
        }  # fmt: skip

    @staticmethod
    def from_json(node: Node) -> SunlitGround:
        """Return the ground of `to_json`. Raises the node's error."""
        width, height = (child.integer(at_least=1) for child in node.key("shape").elements())
        try:
            bits = np.frombuffer(zlib.decompress(base64.b64decode(node.key("cells").text())), np.uint8)
            lit = np.unpackbits(bits, count=width * height).astype(bool).reshape(width, height)
        except (ValueError, zlib.error) as fault:
            node.key("cells").fail(f"are no cells: {fault}")
        return SunlitGround(node.key("corner").array(2), node.key("cell_m").number(), lit)
