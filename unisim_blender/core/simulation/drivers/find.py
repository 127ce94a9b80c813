"""The driver of a name: a registered one, or a function of a module."""

from __future__ import annotations

import importlib
from dataclasses import replace

from ...errors import UnisimError, in_a_line
from .driver import DRIVERS, DriverKind, Endpoint


def driver_named(name: str, endpoint: Endpoint | None = None) -> DriverKind:
    """Return the driver of a name: one of `DRIVERS`, at ``endpoint`` if it is remote, or ``module:function``, which is called
    with a `Setup` and returns a `Driver`. Raises `UnisimError`."""
    kind = DRIVERS.get(name)
    remote = None if kind is None else kind.remote
    if endpoint is not None and remote is None:
        raise UnisimError(f'--driver-address {endpoint.address}: the driver "{name}" has none')
    if kind is not None and remote is None:
        return kind
    if kind is not None and remote is not None:
        if endpoint is None:
            raise UnisimError(f'--driver "{name}": needs --driver-address')
        return replace(kind, start=remote(endpoint))
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
