"""Detections and labels drawn over sweeps from above and over images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from unisim_blender.core.evaluation.autonomy.document import FrameOutput, bev_corners
from unisim_blender.core.geometry import FloatArray

from .samples import X_M, Sample

LABEL, IGNORED, DETECTION = (70, 220, 90), (120, 120, 120), (255, 150, 40)
SCALE = 3
HALF_M = 20.0
PIXELS_PER_M = 9
_GROUND_M = 0.25


def image(kind: str, sample: Sample, truth: FrameOutput, found: FrameOutput) -> NDArray[np.uint8]:
    """Labels green, ignored ones grey, detections orange with their scores (H, W, 3)."""
    canvas = _sweep(sample) if kind == "bev" else _image(sample)
    draw = ImageDraw.Draw(canvas)
    outline = _from_above if kind == "bev" else _in_image
    for corners, ignored in zip(outline(truth.boxes), truth.ignored, strict=True):
        draw.polygon([tuple(p) for p in corners], outline=IGNORED if ignored else LABEL, width=2)
    for corners, score in zip(outline(found.boxes), found.scores, strict=True):
        draw.polygon([tuple(p) for p in corners], outline=DETECTION)
        draw.text(tuple(corners.min(0) - [0, 10]), f"{100 * score:.0f}", fill=DETECTION)
    return np.asarray(canvas)


def _image(sample: Sample) -> Image.Image:
    height, width = sample.image.shape[:2]
    return Image.fromarray(sample.image).resize((SCALE * width, SCALE * height), Image.Resampling.BICUBIC)


def _in_image(boxes: FloatArray) -> FloatArray:
    return SCALE * boxes[:, [[0, 1], [2, 1], [2, 3], [0, 3]]]


def _sweep(sample: Sample) -> Image.Image:
    width, height = round((X_M[1] - X_M[0]) * PIXELS_PER_M), round(2 * HALF_M * PIXELS_PER_M)
    place = np.floor(_to_pixels(sample.points[:, :2].astype(np.float64))).astype(np.int64)
    inside = ((place >= 0) & (place < [width, height])).all(-1)
    canvas = np.full((height, width, 3), 16, np.uint8)
    for chosen, shade in ((sample.points[:, 2] <= _GROUND_M, 50), (sample.points[:, 2] > _GROUND_M, 190)):
        column, row = place[inside & chosen].T
        canvas[row, column] = shade
    return Image.fromarray(canvas)


def _to_pixels(xy: FloatArray) -> FloatArray:
    return np.stack([(xy[..., 0] - X_M[0]) * PIXELS_PER_M, (HALF_M - xy[..., 1]) * PIXELS_PER_M], -1)


def _from_above(boxes: FloatArray) -> FloatArray:
    return _to_pixels(bev_corners(boxes))
