"""Whether a configuration's values can be built at all: a model of them is made only afterwards."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal, get_args, get_origin, get_type_hints

from ..errors import SceneError

MOST = 1 << 24
"""No number of a configuration is larger: what asks for more is broken, and would fill the memory before anything noticed."""


def check_config(config: Any, where: str) -> None:
    """Check a configuration's numbers and words (a dataclass, nested ones included). SceneError names ``where`` and the value."""
    hints = get_type_hints(type(config))
    for field in dataclasses.fields(config):
        value, kind, place = getattr(config, field.name), hints[field.name], f"{where}.{field.name}"
        if dataclasses.is_dataclass(value):
            check_config(value, place)
        elif get_origin(kind) is Literal:
            if value not in get_args(kind):
                raise SceneError(f"{place} is {value!r}, not one of {', '.join(map(repr, get_args(kind)))}")
        elif kind is int and not (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST):
            raise SceneError(f"{place} is {value!r}, not a whole number from 1 to {MOST}")
        elif kind is float and not (isinstance(value, (int, float)) and math.isfinite(value) and 0 < value <= MOST):
            raise SceneError(f"{place} is {value!r}, not a number above 0 and up to {MOST}")
