"""Lens models. A new one is a file with a `Lens`, and a line in `LENSES`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .f_theta import FTheta
from .lens import Lens, LensError
from .mei import Mei
from .opencv_fisheye import OpenCVFisheye
from .opencv_pinhole import OpenCVPinhole
from .pinhole import Pinhole

LENSES: dict[str, type[Lens]] = {
    "pinhole": Pinhole,
    "opencv_pinhole": OpenCVPinhole,
    "opencv_fisheye": OpenCVFisheye,
    "f_theta": FTheta,
    "mei": Mei,
}
"""Lens models by the name that files give them."""
PINHOLE = Pinhole()


def lens_from_dict(values: object) -> Lens:
    """Return the lens of its JSON form, `Lens.to_dict`. Raises `LensError`."""
    if not isinstance(values, Mapping):
        raise LensError(f"a lens must be an object with a type, not {values!r:.60}")
    given: dict[str, Any] = dict(values)
    name = given.pop("type", None)
    if not isinstance(name, str) or name not in LENSES:
        raise LensError(f"type: must be one of {', '.join(LENSES)}, not {name!r:.60}")
    return LENSES[name].from_parameters(given)
