"""How much of a box is hidden: by what stops beams that would have met it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry import FloatArray, intersect_boxes, invert_pose, points_in_box

INNER = 0.8
"""Beams count that meet this share of a box: those along its edges end on the ground beside it, too."""
BEFORE_M = 0.3
"""A beam that ends this far before a box is stopped by something else."""


def hidden_shares(
    origins: FloatArray, points: FloatArray, poses: FloatArray, sizes_m: FloatArray
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return of boxes, poses (A, 4, 4) and sizes (A, 3), and a sweep's returns, rays from ``origins`` to ``points`` (N, 3): the
    share of the rays towards each box that end before it (A,), NaN where none goes there; and how many returns lie in it (A,).

    Dropped rays tell nothing.
    """
    ways = points - origins
    distance = np.linalg.norm(ways, axis=1)
    rays = ways / np.maximum(distance, 1e-9)[:, None]
    shares, inside = np.full(len(sizes_m), np.nan), np.zeros(len(sizes_m), np.int64)
    for at, (pose, size) in enumerate(zip(poses, np.asarray(sizes_m), strict=True)):
        aside = pose[:3, 3] - origins
        away, radius = np.linalg.norm(aside, axis=1), float(np.linalg.norm(size)) / 2
        # of a ray that begins in the box's ball any may meet it
        ahead = np.sqrt(np.maximum(away**2 - radius**2, 0.0))
        near = np.flatnonzero((away <= radius) | ((rays * aside).sum(1) >= ahead))
        if not len(near):
            continue
        inside[at] = points_in_box(points[near], pose, size).sum()
        # the inner box and the whole one
        sizes, places = np.stack([INNER * size, size]), np.broadcast_to(invert_pose(pose), (2, 4, 4))
        enter, leave = intersect_boxes(origins[near], rays[near], places, sizes)
        met = (enter[:, 0] <= leave[:, 0]) & (leave[:, 0] > 0)
        if met.any():
            shares[at] = float((distance[near][met] < enter[met, 1] - BEFORE_M).mean())
    return shares, inside
