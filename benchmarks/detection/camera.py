"""A detector of vehicles in images without anchors, after FCOS (Tian et al., ICCV 2019), small.

As there: every cell in a box's middle gives the distances to its four sides. Other than there: of boxes that share a
cell the nearest vehicle's has it, not the smallest; one output level, at a quarter of the resolution; no centre-ness.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch import nn

from unisim_blender.core.geometry import BoolArray, FloatArray

from .detector import Example, Pyramid
from .samples import LEAST_INSIDE, LEAST_PIXELS, LEAST_POINTS, MOST_HIDDEN, Sample

STRIDE = 4
USUAL_PX = 16.0
"""Distance to a side whose logarithm is 0."""
LEAST_PX = 1.0
MIDDLE = 0.4
"""A cell in the box scaled by this is a vehicle's; in the rest of the box it does not count."""
REGRESSION = 4
MEAN, DEVIATION = 0.45, 0.25


class CameraDetector:
    """See `detector.Detector`."""

    name, kind, overlap = "camera", "image", 0.5

    def network(self) -> nn.Module:
        """Some 0.3 million weights."""
        return Pyramid(3, (16, 32, 48, 64, 96), 1 + REGRESSION, 48)

    def example(self, sample: Sample, rng: np.random.Generator | None) -> Example:
        """The image; for training a part of it enlarged, mirrored, its brightness and contrast changed."""
        image, boxes, ignored = sample.image, sample.boxes, sample.boxes_ignored
        if rng is not None:
            image, boxes, inside = cropped(sample, rng)
            low = boxes[:, 3] - boxes[:, 1] < LEAST_PIXELS
            ignored = (sample.hits < LEAST_POINTS) | low | (inside < LEAST_INSIDE) | (sample.hidden > MOST_HIDDEN)
            if rng.random() < 0.5:
                image, boxes = mirrored(image, boxes)
        pixels = (image.astype(np.float32) / 255 - MEAN) / DEVIATION
        if rng is not None:
            pixels = pixels * rng.uniform(0.8, 1.25) + rng.uniform(-0.3, 0.3)
        order = sample.nearest_first[::-1]
        order = order[(boxes[order, 2] > boxes[order, 0]) & (boxes[order, 3] > boxes[order, 1])]
        height, width = -(-image.shape[0] // STRIDE), -(-image.shape[1] // STRIDE)
        classes, regression = encode(boxes[order], np.asarray(ignored)[order], height, width)
        return Example(np.ascontiguousarray(pixels.transpose(2, 0, 1), np.float32), classes, regression)

    def boxes(self, regression: NDArray[np.float32], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> FloatArray:
        """left, top, right, bottom."""
        return decode_boxes(regression, rows, columns)

    def labels(self, sample: Sample) -> tuple[NDArray[np.float32], BoolArray]:
        """Vehicles in the image, those small, cut off or hidden ignored."""
        there = sample.inside > 0
        return sample.boxes[there], sample.boxes_ignored[there]


def cropped(
    sample: Sample, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]:
    """A part of the image at its size, the boxes in it, and what share of each vehicle is in it."""
    height, width = sample.image.shape[:2]
    share = rng.uniform(0.7, 1.0)
    left, top = rng.uniform(0, 1 - share) * width, rng.uniform(0, 1 - share) * height
    box = (left, top, left + share * width, top + share * height)
    image = np.asarray(Image.fromarray(sample.image).resize((width, height), Image.Resampling.BILINEAR, box=box))
    boxes = (sample.boxes - np.array([left, top, left, top], np.float32)) / np.float32(share)
    clipped = np.clip(boxes, 0, np.array([width, height, width, height], np.float32))
    before, after = (np.maximum(np.prod(b[:, 2:] - b[:, :2], -1), 0) for b in (boxes, clipped))
    inside = sample.inside * np.divide(after, before, out=np.zeros_like(after), where=before > 0)
    return image, clipped.astype(np.float32), inside


def mirrored(image: NDArray[np.uint8], boxes: NDArray[np.float32]) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Left and right exchanged."""
    out = boxes.copy()
    out[:, 0], out[:, 2] = image.shape[1] - boxes[:, 2], image.shape[1] - boxes[:, 0]
    return image[:, ::-1], out


def encode(
    boxes: NDArray[np.float32], ignored: BoolArray, height: int, width: int
) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Class (h, w) and regression maps (4, h, w) of boxes (V, 4): log distances to left, top, right, bottom.

    Of boxes that share a cell the last has it.
    """
    rows, columns = np.mgrid[:height, :width]
    x, y = (columns + 0.5) * STRIDE, (rows + 0.5) * STRIDE
    classes, regression = np.zeros((height, width), np.int8), np.zeros((REGRESSION, height, width), np.float32)
    for (left, top, right, bottom), uncounted in zip(boxes.astype(np.float64), ignored, strict=True):
        u, v, half_u, half_v = (left + right) / 2, (top + bottom) / 2, (right - left) / 2, (bottom - top) / 2
        out = np.maximum(np.abs(x - u) / half_u, np.abs(y - v) / half_v)
        classes[(out <= 1) & (classes == 0)] = -1
        if uncounted:
            classes[out <= MIDDLE] = -1
            continue
        home = (np.abs(x - u) <= STRIDE / 2) & (np.abs(y - v) <= STRIDE / 2)
        mine = (out <= MIDDLE) | home
        classes[mine] = 1
        distances = np.stack([x - left, y - top, right - x, bottom - y])[:, mine]
        regression[:, mine] = np.log(np.maximum(distances, LEAST_PX) / USUAL_PX)
    return classes, regression


def decode_boxes(regression: NDArray[np.float32], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> FloatArray:
    """Boxes (N, 4) of cells (N,), (N,): `encode` backwards."""
    left, top, right, bottom = np.exp(np.clip(regression[:, rows, columns].astype(np.float64), -4, 4)) * USUAL_PX
    x, y = (columns + 0.5) * STRIDE, (rows + 0.5) * STRIDE
    return np.stack([x - left, y - top, x + right, y + bottom], -1)
