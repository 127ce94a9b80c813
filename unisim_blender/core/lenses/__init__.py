"""Lens models. A new one is a file with a `Lens`, and its name among `registry`'s; or another package's, see there."""

from __future__ import annotations

from .registry import LENSES, Pinhole, lens_from_dict, register

__all__ = ["LENSES", "PINHOLE", "lens_from_dict", "register"]
PINHOLE = Pinhole()
