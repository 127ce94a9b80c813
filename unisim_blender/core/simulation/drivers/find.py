"""The driver of a name: a registered one, or a function of a module."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from dataclasses import replace
from types import ModuleType

from ...errors import UnisimError, in_a_line, short
from .driver import DRIVERS, DriverKind, Endpoint

MOST_NAMES = 10
"""So many names are told of a module that lacks the one that was asked for."""


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
    loaded = _module(name, module)
    found = getattr(loaded, function, None)
    if found is None:
        own = [key for key, one in vars(loaded).items() if getattr(one, "__module__", None) == module and callable(one)]
        has = f"; it has {', '.join(own[:MOST_NAMES])}" if own else ""
        where = getattr(loaded, "__file__", None) or module
        raise UnisimError(f'--driver "{name}": {where} has no {short(function)}{has}')
    if not callable(found):
        raise UnisimError(f'--driver "{name}": {function} must be a function of a Setup, not a {type(found).__name__}')
    return DriverKind(name, "of a module", found)


def _module(name: str, module: str) -> ModuleType:
    """Import the module of a driver, also from the working directory, as ``python -m`` does. Raises `UnisimError`."""
    here = os.getcwd()
    if here not in sys.path and "" not in sys.path:
        sys.path.insert(0, here)
        importlib.invalidate_caches()
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise UnisimError(f'--driver "{name}": {module} imports a module that is absent: {error.name}') from error
        hint = f"; write {module.removesuffix('.py')}:{name.partition(':')[2]}" if module.endswith(".py") else ""
        raise UnisimError(
            f'--driver "{name}": Python finds no module {short(error.name)}, neither in {here} nor where it looks else{hint}'
        ) from error
    except (Exception, SystemExit) as error:
        steps = traceback.extract_tb(error.__traceback__)
        lines = [one for one in steps if not one.filename.startswith("<frozen") and one.filename != importlib.__file__]
        place = f"{lines[-1].filename}, line {lines[-1].lineno}: " if len(lines) > 1 else ""
        text = in_a_line(Exception(str(error) or type(error).__name__))
        raise UnisimError(f'--driver "{name}": cannot be imported: {place}{type(error).__name__}: {text}') from error
