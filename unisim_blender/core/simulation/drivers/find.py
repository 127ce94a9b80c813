"""The driver of a name: a registered one, or a function of a module."""

from __future__ import annotations

import importlib

from ...errors import UnisimError, in_a_line
from .driver import DRIVERS, DriverKind


def driver_named(name: str) -> DriverKind:
    """Return the driver of a name: one of `DRIVERS`, or ``module:function``, which is called with a `Setup` and returns a
    `Driver`. Raises `UnisimError`."""
    if name in DRIVERS:
        return DRIVERS[name]
    module, colon, function = name.partition(":")
    if not colon or not module or not function:
        raise UnisimError(f'--driver "{name}": must be one of {", ".join(DRIVERS)}, or module:function')
    try:
        found = getattr(importlib.import_module(module), function)
    except Exception as error:  # noqa: BLE001  a module of the user's may raise anything
        raise UnisimError(f'--driver "{name}": {type(error).__name__}: {in_a_line(error)}') from error
    if not callable(found):
        raise UnisimError(f'--driver "{name}": {function} must be a function of a Setup, not a {type(found).__name__}')
    return DriverKind(name, "of a module", found)
