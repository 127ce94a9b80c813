"""Shutters and lenses as files have them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..json_file import Node
from ..lenses import PINHOLE, lens_from_dict
from ..lenses.lens import Lens, LensError
from .drive import Readouts, RollingShutter

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


def readouts_to_json(readouts: Readouts) -> dict[str, Any]:
    """Return the members of images' readouts."""
    return {"times_s": readouts.times_s.tolist(), "stretch": readouts.stretch.tolist()}


def read_readouts(node: Node) -> Readouts | None:
    """Return the readouts that are the member ``readouts`` of an object; None where it has none. Raises the node's error."""
    if "readouts" not in node.object():
        return None
    node = node.key("readouts")
    times = node.key("times_s").array(-1)
    stretch = node.key("stretch").array(len(times))
    if not len(times) or (np.diff(times) <= 0).any():
        node.key("times_s").fail("must be times that increase")
    if (stretch <= 0).any():
        node.key("stretch").fail("must be above 0")
    return Readouts(times, stretch)
