"""Boxes in an image as boxes on the ground: the lower edge tells the distance, the sides the width."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import BoolArray, FloatArray
from unisim_blender.core.world.drive import CameraModel

from .objects import Detection

LENGTH_M, WIDTH_M = 4.5, 1.9
"""Of a vehicle whose length the image does not tell, or whose sides are cut off."""
WIDTHS_M = (1.5, 2.8)
PIXELS = 1.5
"""Standard deviation of a box's lower edge."""
BORDER_PX = 2.5
"""A side that is nearer to the image's border is cut off."""
FARTHEST_M = 70.0
WEIGHT = 0.1
MOST_HIDDEN = 0.5
"""A box of which a larger share lies within a nearer one is left out: the detector guesses vehicles behind vehicles."""


def from_image(
    boxes: FloatArray, scores: FloatArray, model: CameraModel, rear_axle_from_camera: FloatArray
) -> list[Detection]:
    """Return detections in the rear axle's frame, of boxes (N, 4) left, top, right, bottom in a pinhole's image.

    The ground is the plane z = 0 of that frame, and vehicles are taken to stand along its x axis: of a box whose near end is at
    x the left edge is that of the near or of the far end, by the side on which it is.
    """
    found = []
    height_m = float(rear_axle_from_camera[2, 3])
    for (left, top, right, bottom), score in zip(boxes.tolist(), scores.tolist(), strict=True):
        del top
        ahead, down = _slope(model, rear_axle_from_camera, (left + right) / 2, bottom)[0::2]
        if down >= -1e-3 or ahead <= 0:
            continue  # at the horizon or above
        near = -height_m / down * ahead
        if near > FARTHEST_M:
            continue
        leftmost, rightmost = (
            _slope(model, rear_axle_from_camera, u, bottom)[1] / _slope(model, rear_axle_from_camera, u, bottom)[0]
            for u in (left, right)
        )
        cut = left <= BORDER_PX, right >= model.width - BORDER_PX
        along = PIXELS * near**2 / (model.fy * height_m) + 0.3
        if bottom >= model.height - BORDER_PX:
            # the lower edge is outside the image; of a vehicle right ahead the sides are those of its near end
            if leftmost > 0 > rightmost and not any(cut):
                near = min(near, WIDTH_M / (leftmost - rightmost))
                along = 0.15 * near + 0.3
            else:
                along += 3.0
        far = near + LENGTH_M
        y_left, y_right = leftmost * (near if leftmost > 0 else far), rightmost * (near if rightmost < 0 else far)
        if cut[0] and not cut[1]:
            y_left = y_right + WIDTH_M
        elif cut[1] and not cut[0]:
            y_right = y_left - WIDTH_M
        width = min(max(y_left - y_right, WIDTHS_M[0]), WIDTHS_M[1])
        across = 0.25 + 0.01 * near
        middle = near + LENGTH_M / 2, (y_left + y_right) / 2
        # an error of the distance is one along the ray
        ray = np.array([middle[0], middle[1]]) / np.hypot(*middle)
        aside = np.array([-ray[1], ray[0]])
        covariance = along**2 * np.outer(ray, ray) + across**2 * np.outer(aside, aside)
        x, y = middle[0] + rear_axle_from_camera[0, 3], middle[1] + rear_axle_from_camera[1, 3]
        box, stands = np.array([x, y, LENGTH_M, width, 0.0]), rear_axle_from_camera[:2, 3]
        found.append(Detection(box, covariance, score, WEIGHT, seen_from=stands))
    return found


def not_hidden(boxes: FloatArray, scores: FloatArray) -> BoolArray:
    """Return which boxes (N, 4) are to be used (N,): those that no nearer one with a higher score hides for the most part. The
    nearer one is that whose lower edge is lower."""
    used = np.ones(len(boxes), bool)
    for index, (left, top, right, bottom) in enumerate(boxes.tolist()):
        nearer = (boxes[:, 3] > bottom) & (scores > scores[index])
        width = np.minimum(right, boxes[nearer, 2]) - np.maximum(left, boxes[nearer, 0])
        height = np.minimum(bottom, boxes[nearer, 3]) - np.maximum(top, boxes[nearer, 1])
        shared = np.maximum(width, 0) * np.maximum(height, 0)
        used[index] = bool((shared <= MOST_HIDDEN * (right - left) * (bottom - top)).all())
    return used


def _slope(model: CameraModel, rear_axle_from_camera: FloatArray, u: float, v: float) -> tuple[float, float, float]:
    """The direction of a pixel's ray in the rear axle's frame."""
    ray = rear_axle_from_camera[:3, :3] @ np.array([(u - model.cx) / model.fx, (v - model.cy) / model.fy, 1.0])
    return float(ray[0]), float(ray[1]), float(ray[2])
