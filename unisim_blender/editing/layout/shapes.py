"""Colours of LiDAR points, one for a whole cloud or by what was measured, and of classes of actors; shapes of actors'
boxes, of gizmos as the corners of triangles, and of sensors as line segments: a camera's pyramid and a LiDAR's ring.

The scales of points are the same in every frame, and for recorded and simulated points, so colours can be compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...core.geometry import FloatArray
from ...core.world.drive import Camera
from ..sensors.lenses import undistorted

RECORDED, SIMULATED = "recorded", "simulated"
CLOUD_COLOURS = {RECORDED: (1.0, 0.85, 0.2), SIMULATED: (0.2, 0.8, 1.0)}
"""Of a cloud by its kind, where all of its points have one colour. All colours here are sRGB."""
GREY = (0.55, 0.55, 0.55)
"""Of what is no actor, or was not measured."""
FARTHEST_M = 80.0
"""Depth's scale ends here."""
TURBO = (
    (0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943),
    (0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604),
    (0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973),
)
"""Red, green, blue as polynomials, lowest power first (Mikhailov 2019)."""
TURBO_ENDS = (0.08, 0.95)
"""The map's ends are too dark to be seen against the view."""
VIRIDIS = (
    (0.229, 0.322, 0.546),
    (0.164, 0.471, 0.558),
    (0.128, 0.647, 0.523),
    (0.369, 0.789, 0.383),
    (0.993, 0.906, 0.144),
)
"""At even steps, without the map's dark end."""
GOLDEN = 0.61803398875
"""Turns between the hues of neighbouring numbers."""
SATURATIONS, RUN = np.array([0.85, 0.4, 0.65, 0.25]), 12
"""For a run of numbers each: hues come close again after 13, 21 and 34."""
PointColours = NDArray[np.float32]


def point_colours(kind: str, by: str, attributes: Mapping[str, NDArray[np.generic]], count: int) -> PointColours:
    """Colours (N, 4) of ``count`` points of a kind, by ONE, INTENSITY, DEPTH or INSTANCE of their attributes (N,);
    where there are no instances, by class. Points without what is asked for are grey."""
    assert all(len(values) == count for values in attributes.values()), (
        count,
        {name: len(values) for name, values in attributes.items()},
    )
    if by == "ONE":
        return _opaque(np.tile(CLOUD_COLOURS[kind], (count, 1)))
    if by == "INTENSITY" and "intensity" in attributes:
        return intensity_colours(attributes["intensity"])
    if by == "DEPTH" and "depth" in attributes:
        return depth_colours(attributes["depth"])
    if by == "INSTANCE" and "instance" in attributes:
        return number_colours(attributes["instance"])
    if by == "INSTANCE" and "class" in attributes:
        return number_colours(attributes["class"])
    return _opaque(np.tile(GREY, (count, 1)))


def intensity_colours(intensity: NDArray[np.generic]) -> PointColours:
    """Colours (N, 4) of intensities (N,) in 0..1, blue to yellow. Most are low: the scale goes with the root."""
    share = np.sqrt(np.clip(np.nan_to_num(intensity.astype(float)), 0, 1))
    steps = np.linspace(0, 1, len(VIRIDIS))
    return _opaque(np.stack([np.interp(share, steps, column) for column in np.transpose(VIRIDIS)], -1))


def depth_colours(depth_m: NDArray[np.generic]) -> PointColours:
    """Colours (N, 4) of depths (N,), blue at the sensor, red from `FARTHEST_M` on."""
    share = np.clip(np.nan_to_num(depth_m.astype(float)) / FARTHEST_M, 0, 1)
    x = TURBO_ENDS[0] + (TURBO_ENDS[1] - TURBO_ENDS[0]) * share
    return _opaque(np.clip(np.stack([np.polyval(column[::-1], x) for column in TURBO], -1), 0, 1))


def number_colours(numbers: NDArray[np.generic]) -> PointColours:
    """Colours (N, 4) of whole numbers (N,), one for each; those that are not positive are nothing, and grey."""
    hue = np.mod(numbers.astype(float) * GOLDEN, 1.0)
    turned = np.mod(np.array([5.0, 3.0, 1.0]) + 6 * hue[:, None], 6)
    saturation = SATURATIONS[np.maximum(numbers, 0).astype(int) // RUN % len(SATURATIONS), None]
    rgb = 1 - saturation * np.clip(np.minimum(turned, 4 - turned), 0, 1)
    return _opaque(np.where((numbers.astype(float) > 0)[:, None], rgb, GREY))


def _opaque(rgb: NDArray[np.float64]) -> PointColours:
    return np.concatenate([rgb, np.ones((len(rgb), 1))], -1).astype(np.float32)


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
