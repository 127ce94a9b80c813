"""Drivers and renderers of a simulation as menus have them."""

from __future__ import annotations

import re

from ...core.simulation.drivers import DRIVERS
from ..texts import translatable

OWN = "MODULE"
"""Stands for a function of the user's own."""
DRIVER_TITLES = {
    "log": (translatable("Log"), translatable("The recorded poses, without the dynamics of the vehicle")),
    "constant": (translatable("Constant"), translatable("Straight on at the speed that it starts with")),
    "idm": (
        translatable("IDM (privileged)"),
        translatable("Along the recorded path, behind what is in the way; it is told where everything is"),
    ),
    "egodriver": (
        translatable("AlpaSim Driver"),
        translatable("A process that speaks AlpaSim's protocol of drivers, at an address"),
    ),
}
"""Name and description of each driver for people; of others their own."""
OWN_TITLE = (translatable("Python Function"), translatable("A driver of your own: a function of a module"))
DEFAULT = "constant"


def driver_items() -> list[tuple[str, str, str]]:
    """Return the name of each registered driver, and its title and description; last a function of the user's own."""
    known = [(name, *DRIVER_TITLES.get(name, (name, driver.about))) for name, driver in DRIVERS.items()]
    return [*known, (OWN, *OWN_TITLE)]


def is_remote(name: str) -> bool:
    """Return whether a driver is a process of its own, which has an address."""
    return name in DRIVERS and DRIVERS[name].remote is not None


def is_function(text: str) -> bool:
    """Return whether a text names a function as the command line takes it: module:function."""
    return re.fullmatch(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*", text) is not None


AUTO = "AUTO"
"""Stands for the renderer that a sequence has."""
RENDERER_ITEMS: list[tuple[str, str, str, int]] = [
    (AUTO, translatable("As Sequences"), translatable("The trained scene; without one, surfels of the log"), 0),
    ("surfel", translatable("Surfels"), translatable("Surfels that the log's sweeps give, without training"), 1),
    ("warp", translatable("Warped Images"), translatable("Recorded images warped over surfels, without training"), 2),
    ("street", translatable("Exact Street"), translatable("Procedural streets alone: the street as it is"), 3),
]
"""Identifier, title, description, and the number that files keep. Whether a renderer can show the log, it checks
itself."""


def renderer_options(name: str) -> list[str]:
    """Return the options of the command line for a renderer; none for `AUTO`."""
    return [] if name in ("", AUTO) else ["--renderer", name]
