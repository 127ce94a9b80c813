"""Lens models by the name that files give them: the package's own, what a program registers, and those of other
packages.

Another distribution registers a model in its pyproject.toml; it is loaded when a file first names a model that is not
known:

    [project.entry-points."unisim_blender.lenses"]
    name = "module:LensClass"
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, TypeVar

import numpy as np

from ..geometry import BoolArray, FloatArray
from ..registry import Registry
from .f_theta import FTheta
from .lens import Lens, LensError
from .mei import Mei
from .opencv_fisheye import OpenCVFisheye
from .opencv_pinhole import OpenCVPinhole


@dataclass(frozen=True)
class Pinhole(Lens):
    """A pinhole without distortion. Its valid domain is the half space in front of the camera's plane."""

    TYPE: ClassVar[str] = "pinhole"

    @property
    def max_angle_rad(self) -> float:
        """Less than a right angle."""
        return math.pi / 2

    @property
    def axis_slope(self) -> float:
        return 1.0

    def project(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        z = points[..., 2]
        valid = (z > 0) & np.isfinite(points).all(-1)
        plane = points[..., :2] / np.where(valid, z, 1.0)[..., None]
        return np.where(valid[..., None], plane, np.nan), valid

    def unproject(self, plane: FloatArray) -> FloatArray:
        x, y = plane[..., 0], plane[..., 1]
        length = np.sqrt(x * x + (y * y + 1))
        with np.errstate(invalid="ignore"):
            return np.stack([x / length, y / length, 1 / length], -1)


LensKindT = TypeVar("LensKindT", bound=type[Lens])


def _check_class(kind: object) -> None:
    """Raise `ValueError` unless ``kind`` is a subclass of `Lens` with a name."""
    if not isinstance(kind, type) or not issubclass(kind, Lens):
        raise ValueError(f"{kind!r} is no class of lenses")
    name = getattr(kind, "TYPE", None)
    if not isinstance(name, str) or not name:
        raise ValueError(f"{kind.__name__} has no TYPE, the name that files give it")


LENSES: Registry[type[Lens]] = Registry("a lens", "unisim_blender.lenses", check=_check_class, key="TYPE")
"""The registered lens models by their ``TYPE``."""


def register(kind: LensKindT) -> LensKindT:
    """Make a lens model known by its ``TYPE``; a decorator. Raises `ValueError` where there is another of that name."""
    LENSES.register(kind)
    return kind


for _own in (Pinhole, OpenCVPinhole, OpenCVFisheye, FTheta, Mei):
    register(_own)


def lens_from_dict(values: object) -> Lens:
    """Return the lens of its JSON form, `Lens.to_dict`. Raises `LensError`."""
    if not isinstance(values, Mapping):
        raise LensError(f"a lens must be an object with a type, not {values!r:.60}")
    given: dict[str, Any] = dict(values)
    name = given.pop("type", None)
    # other packages' are loaded where the package has none of that name
    lenses = LENSES if isinstance(name, str) and name in LENSES else LENSES.with_plugins()
    if not isinstance(name, str) or name not in lenses:
        raise LensError(f"type: must be one of {', '.join(lenses)}, not {name!r:.60}")
    try:
        return _lens_of(lenses[name], json.dumps(given, sort_keys=True))
    except TypeError:  # what no file holds: the model says what is wrong
        return lenses[name].from_parameters(given)


@lru_cache(maxsize=256)
def _lens_of(kind: type[Lens], parameters: str) -> Lens:
    """Make a lens, once: finding its valid domain takes milliseconds, and Blender asks at every redraw."""
    return kind.from_parameters(json.loads(parameters))
