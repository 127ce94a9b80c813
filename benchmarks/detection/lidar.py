"""A bird's-eye-view detector of LiDAR sweeps after PIXOR (Yang et al., CVPR 2018), small.

As there: a sweep as an image of height slices and intensity from above, convolutions, a box from every cell within a
vehicle, no anchors. Other than there: cells of 0.25 m, fewer layers, and the angle as cosine and sine of its double,
for a box turned by half a circle is the same box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from torch import nn

from unisim_blender.core.geometry import BoolArray, FloatArray

from .detector import Example, Pyramid
from .samples import LEAST_POINTS, X_M, Y_M, Z_M, Sample

CELL_M = 0.25
STRIDE = 4
SLICES_M = np.array([Z_M[0], 0.2, 0.6, 1.0, 1.4, 1.8, 2.4, 3.4, Z_M[1]])
CHANNELS = len(SLICES_M) - 1 + 2
REGRESSION = 6
USUAL_M = (4.5, 2.1)
"""Length and width whose logarithms are 0."""
MIDDLE, WHOLE = 0.5, 1.2
"""A cell in the box scaled by the first is a vehicle's; between that and the second it does not count."""
CROP_M = 32.0
"""Width of the strips that are trained on; the network sees the whole region when it is tested."""


class LidarDetector:
    """See `detector.Detector`."""

    name, kind, overlap = "lidar", "bev", 0.1

    def __init__(self, y_m: tuple[float, float] = Y_M) -> None:
        self.y_m = y_m

    def network(self) -> nn.Module:
        """Some 0.2 million weights."""
        return Pyramid(CHANNELS, (24, 40, 64, 80), 1 + REGRESSION, 48)

    def example(self, sample: Sample, rng: np.random.Generator | None) -> Example:
        """The sweep as an image; for training turned by up to 10 degrees, scaled by 5 %, mirrored,
        and a strip of it."""
        points, boxes, low = sample.points, sample.bev, self.y_m[0]
        ignored, high = sample.hits < LEAST_POINTS, self.y_m[1]
        if rng is not None:
            points, boxes = varied(points, boxes, rng)
            middle = float(rng.normal(0, 4) if rng.random() < 0.8 else rng.uniform(-24, 24))
            low, high = middle - CROP_M / 2, middle + CROP_M / 2
        image = raster(points, (low, high))
        classes, regression = encode(boxes, ignored, image.shape[1] // STRIDE, image.shape[2] // STRIDE, low)
        return Example(image, classes, regression)

    def boxes(self, regression: NDArray[np.float32], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> FloatArray:
        """x, y, length, width, yaw."""
        return decode_boxes(regression, rows, columns, self.y_m[0])

    def labels(self, sample: Sample) -> tuple[NDArray[np.float32], BoolArray]:
        """Vehicles, those with few returns or outside the region ignored."""
        return sample.bev, sample.bev_ignored


def varied(
    points: NDArray[np.float32], boxes: NDArray[np.float32], rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Points (N, 4) and boxes (V, 5) turned about the vehicle, scaled and mirrored alike, by chance."""
    angle, scale = rng.uniform(-1, 1) * np.radians(10), rng.uniform(0.95, 1.05)
    mirror = -1.0 if rng.random() < 0.5 else 1.0
    c, s = np.cos(angle), np.sin(angle)
    turn = (scale * np.array([[c, s], [-s, c]]) * [1.0, mirror]).astype(np.float32)  # applied from the right
    points, boxes = points.copy(), boxes.copy()
    points[:, :2] = points[:, :2] @ turn
    points[:, 2] *= scale
    boxes[:, :2] = boxes[:, :2] @ turn
    boxes[:, 2:4] *= scale
    boxes[:, 4] = mirror * (boxes[:, 4] + angle)
    return points, boxes


def raster(points: NDArray[np.float32], y_m: tuple[float, float]) -> NDArray[np.float32]:
    """Points (N, 4) from above (C, X, Y): which height slices are occupied, the greatest intensity, log(1 + returns)
    / 4."""
    rows, columns = round((X_M[1] - X_M[0]) / CELL_M), round((y_m[1] - y_m[0]) / CELL_M)
    row = np.floor((points[:, 0] - X_M[0]) / CELL_M).astype(np.int64)
    column = np.floor((points[:, 1] - y_m[0]) / CELL_M).astype(np.int64)
    level = np.searchsorted(SLICES_M, points[:, 2], side="right") - 1
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns) & (level >= 0) & (level < len(SLICES_M) - 1)
    row, column, level, intensity = row[inside], column[inside], level[inside], points[inside, 3]
    out = np.zeros((CHANNELS, rows, columns), np.float32)
    out[level, row, column] = 1.0
    np.maximum.at(out[-2], (row, column), intensity)
    np.add.at(out[-1], (row, column), 1.0)
    out[-1] = np.log1p(out[-1]) / 4
    return out


def cell_middles(rows: NDArray[np.int64], columns: NDArray[np.int64], low_y_m: float) -> tuple[FloatArray, FloatArray]:
    """x, y (N,) of the middles of output cells."""
    size = CELL_M * STRIDE
    return X_M[0] + (rows + 0.5) * size, low_y_m + (columns + 0.5) * size


def encode(
    boxes: NDArray[np.float32], ignored: BoolArray, height: int, width: int, low_y_m: float
) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Class (h, w) and regression maps (6, h, w) of boxes (V, 5): offsets in metres, log sizes, cos and sin
    of twice the yaw."""
    rows, columns = np.mgrid[:height, :width]
    x, y = cell_middles(rows, columns, low_y_m)
    classes, regression = np.zeros((height, width), np.int8), np.zeros((REGRESSION, height, width), np.float32)
    nearest = np.full((height, width), np.inf)
    for box, uncounted in zip(boxes.astype(np.float64), ignored, strict=True):
        dx, dy = box[0] - x, box[1] - y
        c, s = np.cos(box[4]), np.sin(box[4])
        out = np.maximum(np.abs(c * dx + s * dy) / (box[2] / 2), np.abs(c * dy - s * dx) / (box[3] / 2))
        distance = np.hypot(dx, dy)
        home = (np.abs(dx) <= CELL_M * STRIDE / 2) & (np.abs(dy) <= CELL_M * STRIDE / 2)
        classes[(out <= WHOLE) & (classes == 0)] = -1
        if uncounted:
            continue
        mine = ((out <= MIDDLE) | home) & (distance < nearest)
        nearest[mine] = distance[mine]
        classes[mine] = 1
        values = (
            dx,
            dy,
            np.log(box[2] / USUAL_M[0]),
            np.log(box[3] / USUAL_M[1]),
            np.cos(2 * box[4]),
            np.sin(2 * box[4]),
        )
        for channel, value in enumerate(values):
            regression[channel, mine] = np.broadcast_to(value, mine.shape)[mine]
    return classes, regression


def decode_boxes(
    regression: NDArray[np.float32], rows: NDArray[np.int64], columns: NDArray[np.int64], low_y_m: float
) -> FloatArray:
    """Boxes (N, 5) of cells (N,), (N,): `encode` backwards, yaw in (-pi/2, pi/2]."""
    values = regression[:, rows, columns].astype(np.float64)
    x, y = cell_middles(rows, columns, low_y_m)
    size = np.exp(np.clip(values[2:4], -2, 2)) * np.array(USUAL_M)[:, None]
    return np.stack([x + values[0], y + values[1], *size, np.arctan2(values[5], values[4]) / 2], -1)
