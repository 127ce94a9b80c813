"""Outlines of sensors as line segments: a camera's pyramid and a LiDAR's ring."""

from __future__ import annotations

import numpy as np

from ...core.geometry import FloatArray
from ...core.world.drive import Camera
from .lenses import undistorted

RING = 24
"""Points of a LiDAR's ring."""


def pyramid(camera: Camera) -> FloatArray:
    """A camera's pyramid as segments (2 S, 3), Blender's camera axes."""
    model = undistorted(camera.model)
    x, y, z = DISPLAY_M / 2, DISPLAY_M / 2 * model.height / model.width, DISPLAY_M * model.fx / model.width
    corners = [np.array([sx * x, sy * y, -z]) for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    around = [(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    rays = [(np.zeros(3), corner) for corner in corners]
    roof = [
        (corners[2], np.array([0.0, 1.6 * y, -z])),
        (np.array([0.0, 1.6 * y, -z]), corners[3]),
    ]  # tells up from down
    return np.array([*around, *rays, *roof]).reshape(-1, 3)


def ring() -> FloatArray:
    """A LiDAR's ring, with a mark that points along its x, as segments (2 S, 3)."""
    angle = np.linspace(0, 2 * np.pi, RING + 1)
    ring = DISPLAY_M / 2 * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    ahead = np.array([[0.0, 0.0, 0.0], [DISPLAY_M, 0.0, 0.0]])
    return np.concatenate([np.stack([ring[:-1], ring[1:]], 1).reshape(-1, 3), ahead])


DISPLAY_M = 0.4
"""How large cameras and LiDARs are drawn."""
