"""The shape of an actor's box: its corners, faces, and an arrow on its roof that points forward."""

from __future__ import annotations

from collections.abc import Sequence

Corners = list[tuple[float, float, float]]


def box_shape(size_m: Sequence[float]) -> tuple[Corners, list[tuple[int, int]], list[tuple[int, ...]]]:
    """Return vertices, edges and faces of a box of edges (3,) about the origin, and of the arrow, x
    forward and z up."""
    x, y, z = (float(edge) / 2 for edge in size_m)
    corners = [(sx * x, sy * y, sz * z) for sx in (-1, 1) for sy in (-1, 1) for sz in (-1, 1)]
    faces: list[tuple[int, ...]] = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    arrow = [(0.5 * x, -0.6 * y, z), (0.5 * x, 0.6 * y, z), (x, 0.0, z)]
    return corners + arrow, [(8, 9), (9, 10), (10, 8)], faces
