"""Presets by name: what can be trained. Another one is a file in this folder and a line here.

Each line registers one; their order is that of the names in the command line's help and in Blender.
"""

from __future__ import annotations

from ..errors import SceneError
from .preset import PRESETS as PRESETS
from .preset import Preset

# isort: off
from .tiny import TINY as TINY
from .compact import COMPACT as COMPACT
from .small import SMALL as SMALL
from .hd import HD as HD
from .paper import PAPER as PAPER
from .ngp import NGP as NGP
from .nsg import NSG as NSG


def preset(name: str) -> Preset:
    """Return the preset of that name. Raises `SceneError`, which lists the names."""
    if name not in PRESETS:
        raise SceneError(f"no preset {name!r}: there are {', '.join(PRESETS)}")
    return PRESETS[name]


def methods() -> tuple[str, ...]:
    """Return the methods that scenes can be trained by."""
    return tuple(dict.fromkeys(one.method for one in PRESETS.values()))
