"""Shutters and lenses as files have them."""

from __future__ import annotations

from ..json_file import Node
from ..lenses import PINHOLE, lens_from_dict
from ..lenses.lens import Lens, LensError
from .drive import RollingShutter

AXES = ("rows", "columns")


def read_shutter(node: Node) -> RollingShutter:
    """Return the shutter of `RollingShutter.to_dict`; one without ``axis``, as earlier files have it, reads rows."""
    axis = node.key("axis").text() if "axis" in node.object() else "rows"
    if axis not in AXES:
        node.key("axis").fail(f'must be "rows" or "columns", not "{axis}"')
    return RollingShutter(node.key("duration_s").number(), node.key("reference").number(), axis)


def read_lens(node: Node) -> Lens:
    """Return the lens that is the member ``lens`` of an object; an ideal pinhole where it has none."""
    if "lens" not in node.object():
        return PINHOLE
    try:
        return lens_from_dict(node.key("lens").value)
    except LensError as fault:
        node.key("lens").fail(str(fault))
