"""Presets by name: what can be trained. Another one is a file in this folder and a line here."""

from __future__ import annotations

from ..errors import SceneError
from .compact import COMPACT
from .hd import HD
from .ngp import NGP
from .nsg import NSG
from .paper import PAPER
from .preset import Preset
from .small import SMALL
from .tiny import TINY

PRESETS: dict[str, Preset] = {one.name: one for one in (TINY, COMPACT, SMALL, HD, PAPER, NGP, NSG)}
"""By the name that `unisim train --preset` has for them."""


def preset(name: str) -> Preset:
    """Return the preset of that name. Raises `SceneError`, which lists the names."""
    if name not in PRESETS:
        raise SceneError(f"no preset {name!r}: there are {', '.join(PRESETS)}")
    return PRESETS[name]


def methods() -> tuple[str, ...]:
    """Return the methods that scenes can be trained by."""
    return tuple(dict.fromkeys(one.method for one in PRESETS.values()))
