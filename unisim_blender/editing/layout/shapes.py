"""Colours of classes of actors; shapes of what is drawn over a view, of actors' boxes, of gizmos as the corners of
triangles, and of sensors as line segments: a camera's pyramid and a LiDAR's ring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...core.geometry import FloatArray
from ...core.world.drive import Camera
from ..sensors.lenses import undistorted

CAR, TRUCK, PERSON, CYCLE = (0.16, 0.45, 0.85), (0.85, 0.40, 0.10), (0.85, 0.15, 0.35), (0.55, 0.25, 0.80)
COLOURS = {
    "car": CAR, "truck": TRUCK, "bus": TRUCK, "pedestrian": PERSON, "bicycle": CYCLE, "motorcycle": CYCLE,
    "cone": (0.95, 0.60, 0.05), "sign": (0.75, 0.70, 0.15),
    # of other datasets than PandaSet: a REGULAR_VEHICLE and a TYPE_VEHICLE are cars
    "trailer": TRUCK, "cyclist": CYCLE, "person": PERSON, "human": PERSON, "van": CAR, "auto": CAR, "_vehicle": CAR,
}  # fmt: skip
"""By a word of the class, linear RGB; the first that it has."""
OTHER_COLOUR = (0.35, 0.55, 0.45)


def class_colour(label: str) -> tuple[float, float, float]:
    """The colour of a class of actors."""
    words = label.lower()
    return next((colour for word, colour in COLOURS.items() if word in words), OTHER_COLOUR)


Colour = tuple[float, ...]


@dataclass
class OverlayShapes:
    """Triangles (3 T, 2) with a colour for each corner, and texts as (text, x, y, colour), y up."""

    corners: list[Sequence[float]] = field(default_factory=list)
    colours: list[Colour] = field(default_factory=list)
    texts: list[tuple[str, float, float, Colour]] = field(default_factory=list)

    def box(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        """Add a rectangle."""
        self._quad((x, y), (x + width, y), (x + width, y + height), (x, y + height), colour)

    def line(self, points: FloatArray, width: float, colours: Sequence[Colour]) -> None:
        """Add a line through points (P, 2), a colour for each of its pieces; a piece with a NaN is left out."""
        for (a, b), colour in zip(zip(points[:-1], points[1:], strict=True), colours, strict=True):
            along = b - a
            length = float(np.hypot(*along))
            if np.isfinite(length) and length >= 1e-9:
                side = np.array([-along[1], along[0]]) / length * width / 2
                self._quad(a - side, b - side, b + side, a + side, colour)

    def arrays(
        self, corner: Sequence[float] | FloatArray = (0.0, 0.0), scale: float = 1.0
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the triangles' corners (N, 3), scaled and moved to a lower left corner, and their colours (N, 4)."""
        points = np.zeros((len(self.corners), 3), np.float32)
        points[:, :2] = np.asarray(corner) + scale * np.reshape(self.corners, (-1, 2))
        return points, np.asarray(self.colours, np.float32)

    def _quad(
        self, a: Sequence[float], b: Sequence[float], c: Sequence[float], d: Sequence[float], colour: Colour
    ) -> None:
        self.corners += [a, b, c, a, c, d]
        self.colours += [colour] * 6


DISPLAY_M = 0.4
"""Size at which cameras and LiDARs are drawn, in metres."""
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
