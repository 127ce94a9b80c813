"""Edges of boxes as a lens that bends lines shows them."""

from __future__ import annotations

import numpy as np

from ...core.geometry import FloatArray, transform_points
from ...core.world.drive import CameraModel

STEPS = 24
"""Pieces of an edge."""
EDGES = np.array([(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit])
"""Pairs of corners (12, 2), numbered as in `corners`."""


def corners(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the corners (8, 3) of a box between two of them (3,): bit k of a corner's number says that its axis k is high."""
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
    return np.where(bits == 1, high, low)


def bent_edges(model: CameraModel, camera_from_box: FloatArray, box: FloatArray) -> FloatArray:
    """Return the edges of a box with corners ``box`` (8, 3), in the order of `corners`, as segments (S, 2, 2) of an
    image in pixels; ``camera_from_box`` (4, 4) leads to the camera's axes, OpenCV's. What lies outside the lens's valid
    domain or ends outside the image is left out."""
    part = np.linspace(0.0, 1.0, STEPS + 1)[None, :, None]
    ends = transform_points(camera_from_box, box)[EDGES]
    points = ends[:, None, 0] * (1 - part) + ends[:, None, 1] * part
    u, v, valid = model.project(points)
    seen = valid & (u >= 0) & (u <= model.width) & (v >= 0) & (v <= model.height)
    pixels = np.stack([u, v], -1)
    return np.asarray(np.stack([pixels[:, :-1], pixels[:, 1:]], 2)[seen[:, :-1] & seen[:, 1:]])
