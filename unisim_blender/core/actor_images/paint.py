"""Where an image shows a vehicle's paint, its body panels and not glass or tyres, and the ground that is lit alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, invert_pose, transform_points
from ..world.drive import CameraModel
from .best_views import ActorView
from .colour_words import LEAST_PIXELS, LUMINANCE, Tone, colour_word, tone_of

STEPS = 28
"""Places along a panel's length; its height has a third of them."""
GRAZING = 0.25
"""A face at a smaller cosine to the line of sight is not looked at."""

BANDS = {
    "car": (-0.10, 0.10),
    "truck": (-0.05, 0.38),
}
"""Which heights of the box the panels have, as fractions of its height from its middle: above tyres, below windows."""
LEAST_SCORE = 9.0
"""Of a view that a colour is told from; a car of 60 pixels' width that nothing covers has some 40."""
GOOD = 0.6
"""Views that score less than this beside the best one are not asked."""
TRUCKS = ("truck", "bus")
CARS = ("car", "pickup", "van")
ROAD_M = (10.0, 11.0, 12.0, 14.0, 16.0, 19.0, 22.0, 26.0)
"""Distances from the camera at which the road is looked at: nearer there is the recording vehicle itself."""
ROAD_PERCENTILE = 40
"""Of the road's luminance: asphalt, and not the lines on it."""
BESIDE_M = (0.5, 0.9, 1.3, 1.8)
"""Distances from the box at which the ground is looked at."""


def painted_as(label: str) -> str:
    """Return how vehicles of a class are painted: "car" or "truck"; "" where no single colour tells one
    actor from others."""
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
    """The pixels at points (N, 3) of the world that nothing covers, and with ``own`` none in the actor's rectangle."""
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
