"""Shapes of actors' boxes, and of gizmos as the corners of triangles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Corners = list[tuple[float, float, float]]

HEAD, STEM, INNER = 0.14, 0.02, 0.35
"""Of the arrow: half the width of its head and its stem, and the share of its length from which on it can be grabbed,
so that it takes no clicks meant for what stands in the vehicle's place."""
CORNERS = 20


def disc() -> Corners:
    """Return a disc of radius 1 in the plane z = 0."""
    angles = np.linspace(0, 2 * np.pi, CORNERS + 1)
    rim = [(float(np.cos(a)), float(np.sin(a)), 0.0) for a in angles]
    return [corner for a, b in zip(rim[:-1], rim[1:], strict=True) for corner in ((0.0, 0.0, 0.0), a, b)]


def arrow() -> Corners:
    """Return an arrow of length 1 along z, flat in two planes, so that it is seen from everywhere."""
    outline = [(-STEM, 0.0), (STEM, 0.0), (STEM, 0.72), (-STEM, 0.0), (STEM, 0.72), (-STEM, 0.72)]
    outline += [(-HEAD, 0.7), (HEAD, 0.7), (0.0, 1.0)]
    return [(x, 0.0, z) for x, z in outline] + [(0.0, y, z) for y, z in outline]


def box_shape(size_m: Sequence[float]) -> tuple[Corners, list[tuple[int, int]], list[tuple[int, ...]]]:
    """Return vertices, edges and faces of a box of edges (3,) about the origin, and of the arrow, x
    forward and z up."""
    x, y, z = (float(edge) / 2 for edge in size_m)
    corners = [(sx * x, sy * y, sz * z) for sx in (-1, 1) for sy in (-1, 1) for sz in (-1, 1)]
    faces: list[tuple[int, ...]] = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    arrow = [(0.5 * x, -0.6 * y, z), (0.5 * x, 0.6 * y, z), (x, 0.0, z)]
    return corners + arrow, [(8, 9), (9, 10), (10, 8)], faces
