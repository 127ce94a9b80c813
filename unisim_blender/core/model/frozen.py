"""Modules that do not learn for once, without touching those that do: another thread may be using them."""

from __future__ import annotations

import copy
from typing import TypeVar

from torch import nn

M = TypeVar("M", bound=nn.Module)


def frozen(module: M) -> M:
    """The module as it stands: one that shares its parameters' memory and through which they get no gradient."""
    twin = shallow(module)
    for name, parameter in module._parameters.items():
        twin._parameters[name] = None if parameter is None else parameter.detach()  # type: ignore[assignment]
    for name, part in module._modules.items():
        twin._modules[name] = None if part is None else frozen(part)
    return twin


def shallow(module: M) -> M:
    """A module of the same parts, any of which can be set to another without changing the first."""
    twin = copy.copy(module)
    twin._parameters, twin._modules = dict(module._parameters), dict(module._modules)
    return twin
