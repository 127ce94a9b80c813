"""Drivers by name. Another one of the package's own is a file in this folder and a line here; anybody else's is named
``module:function``."""

from __future__ import annotations

# isort: off
from .driver import DRIVERS as DRIVERS
from .driver import Driver as Driver
from .driver import Endpoint as Endpoint
from .builtin import LogDriver as LogDriver
from .builtin import ConstantDriver as ConstantDriver
from .builtin import IdmDriver as IdmDriver
from .egodriver import EGODRIVER as EGODRIVER
from .driver import driver_named as driver_named
