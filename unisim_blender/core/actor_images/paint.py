"""The colour of a vehicle's paint: pixels of body panels, not of glass or tyres, and of the ground under the same
light, and a word for the colour from these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..colour import lab_from_srgb, linear_from_srgb
from ..geometry import FloatArray, invert_pose, transform_points
from ..world.drive import CameraModel
from .best_views import ActorView

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
LEAST_PIXELS = 12
"""Smallest number of pixels of paint, and of ground, from which a colour is determined."""
BELOW, ABOVE = 60, 85
"""Percentiles of the paint's luminance. Gaps, lamps and tyres make panels look darker, seldom brighter."""
BLACK, LIGHT, WHITE = 0.8, 2.6, 4.0
"""Luminance of paint over that of asphalt under the same light: black below the first at `BELOW`; light grey from the
second and white from the third at `ABOVE`."""
WHITE_L = 85.0
"""CIE Lab lightness in the image above which paint looks white, whatever is beside it."""
CHROMA, PLAIN_CHROMA, SATURATION = 8.0, 12.0, 0.25
"""CIE Lab chroma beside the ground's from which on paint has a hue: the first where chroma over lightness is that
saturation, the second in any case, and always for blue, since every glossy body reflects the sky."""
DARKEST_L = 12.0
"""Lower bound of CIE Lab lightness in a saturation: noise of dark pixels has a hue."""
HUES = (
    (20.0, "red"),
    (45.0, "red"),
    (68.0, "orange"),
    (105.0, "yellow"),
    (190.0, "green"),
    (300.0, "blue"),
    (340.0, "purple"),
)
"""Hue angles in CIE Lab (degrees) up to which each word goes; above the last it is red again."""
BROWN_BELOW = 1.6
"""Orange and yellow paint less bright than this beside asphalt is brown."""


@dataclass(frozen=True)
class Tone:
    """Paint beside the ground in one image: luminance ratios at `BELOW` and `ABOVE`, differences in CIE Lab's a and b,
    and the paint's own lightness there."""

    below: float
    above: float
    a: float
    b: float
    lightness: float


def tone_of(paint: NDArray[np.uint8], asphalt: NDArray[np.uint8], ground: NDArray[np.uint8]) -> Tone | None:
    """Return the tone of pixels of paint (N, 3) beside pixels of asphalt (M, 3) and of the ground about it (K, 3),
    sRGB; None where there are too few.

    The ground is taken to be grey: what colour it has is the light's.
    """
    if min(len(paint), len(asphalt), len(ground)) < LEAST_PIXELS:
        return None
    bright = linear_from_srgb(unit(paint)) @ LUMINANCE
    reference = max(float(np.median(linear_from_srgb(unit(asphalt)) @ LUMINANCE)), 1e-4)
    panel = lab_from_srgb(unit(paint[bright >= np.percentile(bright, 40)]))
    lightness, a, b = np.median(panel, 0)
    _, ground_a, ground_b = np.median(lab_from_srgb(unit(ground)), 0)
    below, above = np.percentile(bright, [BELOW, ABOVE]) / reference
    return Tone(float(below), float(above), float(a - ground_a), float(b - ground_b), float(lightness))


def unit(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return pixels in 0..1."""
    return np.asarray(pixels, np.float32) / 255


def colour_word(tones: Sequence[Tone], weights: Sequence[float] | None = None) -> str:
    """Return "white", "light grey", "grey", "black", "red", "orange", "yellow", "green", "blue", "purple" or "brown"
    for one paint's tones in several images, each counted by its weight; "" where there are none."""
    if not tones:
        return ""
    share = np.ones(len(tones)) if weights is None else np.asarray(weights, float)

    def middle(values: list[float]) -> float:
        order = np.argsort(values)
        total = np.cumsum(share[order])
        return float(values[order[int(np.searchsorted(total, total[-1] / 2))]])

    below, above = middle([tone.below for tone in tones]), middle([tone.above for tone in tones])
    a, b = middle([tone.a for tone in tones]), middle([tone.b for tone in tones])
    lightness = middle([tone.lightness for tone in tones])
    hue = hue_word(a, b, lightness)
    if hue in ("orange", "yellow") and below < BROWN_BELOW:
        return "brown"
    if hue:
        return hue
    if below < BLACK and above < LIGHT:  # the grille of a white car is black
        return "black"
    return "white" if above >= WHITE or lightness >= WHITE_L else "light grey" if above >= LIGHT else "grey"


def hue_word(a: float, b: float, lightness: float) -> str:
    """Return the word for a hue in CIE Lab; "" where there is too little of it."""
    chroma, angle = float(np.hypot(a, b)), float(np.degrees(np.arctan2(b, a)) % 360)
    word = next((word for end, word in HUES if angle < end), "red")
    saturated = word not in ("blue", "purple") and chroma >= SATURATION * max(lightness, DARKEST_L)
    return word if chroma >= (CHROMA if saturated else PLAIN_CHROMA) else ""


STEPS = 28
"""Number of places along a panel's length; its height has a third of them."""
GRAZING = 0.25
"""Smallest cosine between a face's normal and the line of sight at which the face is used."""

BANDS = {"car": (-0.10, 0.10), "truck": (-0.05, 0.38)}
"""Heights of the panels, as fractions of the box's height from its middle: above tyres, below windows."""
LEAST_SCORE = 9.0
"""Smallest score of a view from which a colour is determined; an uncovered car of 60 pixels' width has some 40."""
GOOD = 0.6
"""Smallest score of a view, relative to the best one's, that is used."""
TRUCKS = ("truck", "bus")
CARS = ("car", "pickup", "van")
ROAD_M = (10.0, 11.0, 12.0, 14.0, 16.0, 19.0, 22.0, 26.0)
"""Distances from the camera, metres, at which the road is sampled: nearer there is the recording vehicle itself."""
ROAD_PERCENTILE = 40
"""Percentile of the road's luminance that is asphalt, and not the lines on it."""
BESIDE_M = (0.5, 0.9, 1.3, 1.8)
"""Distances from the box, metres, at which the ground is sampled."""


def painted_as(label: str) -> str:
    """Return the kind of paint of a class: "car" or "truck"; "" where no single colour distinguishes actors."""
    words = label.lower().replace("-", " ").split()
    if "pickup" not in words and any(word in words for word in TRUCKS):
        return "truck"
    return "car" if any(word in words for word in CARS) else ""


def paint_points(label: str, size_m: FloatArray, view: ActorView) -> FloatArray:
    """Return points (N, 3) of an actor's paint that face the camera, in the world; none for classes without paint."""
    kind = painted_as(label)
    if not kind:
        return np.zeros((0, 3))
    eye = transform_points(invert_pose(view.pose), view.camera_pose[None, :3, 3])[0]
    size = np.asarray(size_m, float)
    low, high = BANDS[kind]
    heights = np.linspace(low, high, STEPS // 3) * size[2]
    faces = []
    for axis, inset in ((0, 0.26), (1, 0.40)):  # front or rear between its lamps; a side between the corners
        side = 1.0 if eye[axis] > 0 else -1.0
        centre = np.zeros(3)
        centre[axis] = side * size[axis] / 2
        toward = eye - centre
        facing = side * toward[axis] / np.linalg.norm(toward)
        if side * toward[axis] <= 0 or facing < GRAZING:
            continue
        along = 1 - axis
        count = max(2, round(STEPS * facing * size[along] / size.max()))
        spread, tall = np.meshgrid(np.linspace(-inset, inset, count) * size[along], heights)
        face = np.empty((spread.size, 3))
        face[:, axis], face[:, along], face[:, 2] = centre[axis], spread.ravel(), tall.ravel()
        faces.append(face)
    return transform_points(view.pose, np.concatenate(faces)) if faces else np.zeros((0, 3))


def paint_pixels(
    image: NDArray[np.uint8], model: CameraModel, label: str, size_m: FloatArray, view: ActorView
) -> NDArray[np.uint8]:
    """Return the pixels (N, 3) of an actor's paint in an image (H, W, 3), less those that a nearer actor may cover."""
    return _pixels(image, model, paint_points(label, size_m, view), view)


def ground_pixels(
    image: NDArray[np.uint8], model: CameraModel, size_m: FloatArray, view: ActorView
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return pixels of asphalt (N, 3), for how bright the light is, and of the ground beside an actor (M, 3),
    for its colour.

    Asphalt is the road about the camera where that is darker than the ground beside the actor, which may be a pavement.
    """
    half = np.asarray(size_m, float)[:2] / 2
    turns = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    circle = np.stack([np.cos(turns), np.sin(turns)], -1)
    ring = circle / np.abs(circle).max(-1, keepdims=True)
    local = np.concatenate(
        [np.column_stack([ring * (half + out), np.full(len(ring), -size_m[2] / 2)]) for out in BESIDE_M]
    )
    beside = _pixels(image, model, transform_points(view.pose, local), view, own=True)
    height = float(view.pose[2, 3] - size_m[2] / 2)
    around = np.concatenate([view.camera_pose[:2, 3] + circle * away for away in ROAD_M])
    road = _darker(_pixels(image, model, np.column_stack([around, np.full(len(around), height)]), view, own=True))
    if len(beside) < LEAST_PIXELS:
        return road, road
    darker = len(road) >= LEAST_PIXELS and np.median(road @ LUMINANCE) < np.median(beside @ LUMINANCE)
    return (road if darker else beside), beside


def _darker(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Those of pixels (N, 3) whose median luminance is the road's at `ROAD_PERCENTILE`."""
    if not len(pixels):
        return pixels
    bright = pixels @ LUMINANCE
    return np.asarray(pixels[bright <= np.percentile(bright, 2 * ROAD_PERCENTILE)])


def _pixels(
    image: NDArray[np.uint8], model: CameraModel, points: FloatArray, view: ActorView, own: bool = False
) -> NDArray[np.uint8]:
    """Return the pixels at points (N, 3) of the world that nothing covers, and with ``own`` none in the actor's
    rectangle."""
    points = transform_points(invert_pose(view.camera_pose), points)
    points = points[points[:, 2] > 0.3]
    u, v, _ = model.project(points)
    seen = (u >= 0) & (u < model.width) & (v >= 0) & (v < model.height)
    seen &= view.free(u, v, model)
    if own:
        left, top, right, bottom = view.rectangle
        seen &= ~((u >= left) & (u <= right) & (v >= top) & (v <= bottom))
    return np.asarray(image[v[seen].astype(int), u[seen].astype(int)])


def paint_tone(
    image: NDArray[np.uint8], model: CameraModel, label: str, size_m: FloatArray, view: ActorView
) -> Tone | None:
    """Return the tone of an actor's paint in an image (H, W, 3); None where too little of it is seen."""
    return tone_of(paint_pixels(image, model, label, size_m, view), *ground_pixels(image, model, size_m, view))


def word_of(tones: Sequence[tuple[Tone | None, float]]) -> str:
    """Return the word for the colour of tones, each with its view's score; "" where none tells it."""
    known = [(tone, score) for tone, score in tones if tone is not None]
    return colour_word([tone for tone, _ in known], [score for _, score in known])


def telling(views: Sequence[ActorView]) -> list[ActorView]:
    """Return the views that a colour can be told from: large enough, little covered, and not much
    worse than the best."""
    best = max((view.score for view in views), default=0.0)
    return [view for view in views if view.score >= max(LEAST_SCORE, GOOD * best)]
