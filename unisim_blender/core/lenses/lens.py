"""Interface of all lens models: a projection with a stated valid domain, its inverse, and a JSON form.

A lens maps directions of the camera's frame (x right, y down, z along the optical axis) to points of a plane in units
of the focal length. `world.drive.CameraModel` turns these into pixels: ``u = fx * x + cx``, ``v = fy * y + cy``. So a
lens does not change when its images are resized.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, ClassVar

import numpy as np

from ..errors import UnisimError, short
from ..geometry import BoolArray, FloatArray

NARROWEST_RAD = math.radians(1.0)
"""Smallest angle from the optical axis, radians, at which the valid domain of a lens may end."""
LEAST_SLOPE = 1e-3
"""Smallest slope of the projection inside the valid domain, relative to that on the axis: beyond it the image folds."""

EDGE = 1 + 1e-12
"""Factor by which rounding may carry a point of the valid domain's edge beyond it."""


class LensError(UnisimError):
    """Parameters that do not define a lens."""


class Lens(ABC):
    """A lens. Subclasses are frozen dataclasses of numbers and tuples of numbers, which compare and hash by content.

    ``TYPE`` names the model in JSON.
    """

    TYPE: ClassVar[str]

    @property
    @abstractmethod
    def max_angle_rad(self) -> float:
        """The valid domain: directions up to this angle from the optical axis. The projection is one to one on it."""

    @property
    @abstractmethod
    def axis_slope(self) -> float:
        """Slope of the projection at the optical axis: distance in the plane per radian."""

    @abstractmethod
    def project(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Project points or directions (..., 3) of the camera's frame, of any length, onto the plane (..., 2).

        The second array (...) is True where a point lies in the valid domain; elsewhere the plane's coordinates are
        NaN.
        """

    @abstractmethod
    def unproject(self, plane: FloatArray) -> FloatArray:
        """Return unit directions (..., 3) through points (..., 2) of the plane; NaN where no direction of the valid
        domain projects there. Each depends on its own point alone, to the last bit."""

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form: ``type`` and the parameters; ones that are at their default are left out."""
        given = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}  # type: ignore[arg-type]
        return {"type": self.TYPE, **{name: list(x) if isinstance(x, tuple) else x for name, x in given.items()}}

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> Lens:
        """Return the lens of the members of its JSON form, less ``type``. Raises `LensError`."""
        known = {f.name for f in fields(cls)}  # type: ignore[arg-type]
        for name in values:
            if name not in known:
                raise LensError(f'{cls.TYPE}: has no parameter "{name}", but {", ".join(sorted(known)) or "none"}')
        given = {name: tuple(x) if isinstance(x, (list, tuple)) else x for name, x in values.items()}
        try:
            return cls(**given)
        except TypeError as fault:
            lacking = [f.name for f in fields(cls) if f.name not in given]  # type: ignore[arg-type]
            raise LensError(f"{cls.TYPE}: lacks {' or '.join(lacking)}") from fault

    def check_numbers(self, *names: str) -> None:
        """Raise `LensError` where a parameter is no finite number."""
        for name in names:
            value = getattr(self, name)
            if not is_number(value):
                raise LensError(f"{self.TYPE}: {name} must be a finite number, not {short(value)}")

    def check_domain(self) -> None:
        """Raise `LensError` where the parameters leave next to no valid domain."""
        angle = self.max_angle_rad
        if not angle >= NARROWEST_RAD:
            raise LensError(
                f"{self.TYPE}: the parameters fold or tear the image {math.degrees(angle):.2f} degrees from the optical "
                f"axis, which leaves no image"
            )


def is_number(value: object) -> bool:
    """Return whether a value is a finite number that a float64 holds, and no bool."""
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


def angle_and_heading(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the angle (...), radians, of points (..., 3) from the optical axis, and the unit vector (...), (...) of
    their heading from it; (1, 0) on the axis. NaN where a point is not finite."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    aside = np.hypot(x, y)
    on_axis = aside == 0
    safe = np.where(on_axis, 1.0, aside)
    # a point at the camera's own place has no direction
    angle = np.where(on_axis & (z == 0), np.nan, np.arctan2(aside, z))
    with np.errstate(invalid="ignore"):
        return angle, np.where(on_axis, 1.0, x / safe), np.where(on_axis, 0.0, y / safe)


def direction_of(angle: FloatArray, x: FloatArray, y: FloatArray, radius: FloatArray) -> FloatArray:
    """Return unit directions (..., 3) at ``angle`` (...) from the optical axis towards (x, y) (...) of length
    ``radius``."""
    on_axis = radius == 0
    safe = np.where(on_axis, 1.0, radius)
    sine = np.sin(angle)
    with np.errstate(invalid="ignore"):
        heading_x, heading_y = np.where(on_axis, 1.0, x / safe), np.where(on_axis, 0.0, y / safe)
    return np.stack([sine * heading_x, sine * heading_y, np.cos(angle)], -1)
