"""Lens models by the name that files give them: the package's own, what a program registers, and those of other packages.

Another distribution registers a model in its pyproject.toml; it is loaded when a file first names a model that is not known:

    [project.entry-points."unisim_blender.lenses"]
    name = "module:LensClass"
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any, TypeVar

from ..errors import in_a_line
from ..plugins import entries
from .f_theta import FTheta
from .lens import Lens, LensError
from .mei import Mei
from .opencv_fisheye import OpenCVFisheye
from .opencv_pinhole import OpenCVPinhole
from .pinhole import Pinhole

GROUP = "unisim_blender.lenses"

LensKindT = TypeVar("LensKindT", bound=type[Lens])

LENSES: dict[str, type[Lens]] = {}


def register(kind: LensKindT) -> LensKindT:
    """Make a lens model known by its ``TYPE``; a decorator. Raises ValueError where there is another of that name."""
    if not isinstance(kind, type) or not issubclass(kind, Lens):
        raise ValueError(f"{kind!r} is no class of lenses")
    name = getattr(kind, "TYPE", None)
    if not isinstance(name, str) or not name:
        raise ValueError(f"{kind.__name__} has no TYPE, the name that files give it")
    if LENSES.get(name, kind) is not kind:
        raise ValueError(f"there is a lens {name!r} already")
    LENSES[name] = kind
    return kind


for _own in (Pinhole, OpenCVPinhole, OpenCVFisheye, FTheta, Mei):
    register(_own)


def lens_from_dict(values: object) -> Lens:
    """Return the lens of its JSON form, `Lens.to_dict`. Raises `LensError`."""
    if not isinstance(values, Mapping):
        raise LensError(f"a lens must be an object with a type, not {values!r:.60}")
    given: dict[str, Any] = dict(values)
    name = given.pop("type", None)
    if isinstance(name, str) and name not in LENSES:
        _load_installed()
    if not isinstance(name, str) or name not in LENSES:
        raise LensError(f"type: must be one of {', '.join(LENSES)}, not {name!r:.60}")
    try:
        return _made(LENSES[name], json.dumps(given, sort_keys=True))
    except TypeError:  # what no file holds: the model says what is wrong
        return LENSES[name].from_parameters(given)


@lru_cache(maxsize=256)
def _made(kind: type[Lens], parameters: str) -> Lens:
    """Make a lens, once: finding its valid domain takes milliseconds, and Blender asks at every redraw."""
    return kind.from_parameters(json.loads(parameters))


@cache
def _load_installed() -> None:
    """Register the models of other packages, once. Those that cannot be loaded are left out, with a warning each."""
    for entry in entries(GROUP):
        try:
            register(entry.load())
        except Exception as error:  # noqa: BLE001  another package's code may raise anything, and the others still work
            about = f"{type(error).__name__}: {in_a_line(error)}"
            warnings.warn(f"the lens {entry.name!r} ({entry.value}) is left out: {about}", stacklevel=4)
