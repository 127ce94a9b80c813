"""Shapes of gizmos as the corners of triangles."""

from __future__ import annotations

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
