"""Measured values as images: depth, differences, sweeps from above, and contact sheets of labelled images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..colour import bytes_from_srgb
from ..files import write_file
from ..geometry import BoolArray, FloatArray, invert_pose, transform_points
from ..output.frame_files import png_bytes
from .metrics import ImageArray

Pixels = NDArray[np.uint8]
BACKGROUND = 24
LABEL_HEIGHT = 18
GAP = 4
METRES_PER_PIXEL = 0.2


def turbo(values: NDArray[Any]) -> Pixels:
    """Colours (..., 3) of values (...) in 0..1 from blue over green to red.

    The polynomial of R. Du for A. Mikhailov's Turbo, "Turbo, an improved rainbow colormap for visualization" (2019).
    """
    x = np.clip(np.nan_to_num(np.asarray(values, np.float64), nan=0.0), 0, 1)
    powers = np.stack([np.ones_like(x), x, x**2, x**3, x**4, x**5], -1)
    coefficients = np.array(
        [
            [0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943],
            [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604],
            [0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973],
        ]
    )
    return bytes_from_srgb((powers @ coefficients.T).astype(np.float32))


NEAREST_M, FURTHEST_M = 2.0, 120.0
"""Depths between which colours change."""
WHITE_DIFFERENCE = 0.25


def depth_image(depth_m: NDArray[np.float32]) -> Pixels:
    """Depth (H, W) by its logarithm, near in red; black where nothing was hit."""
    hit = np.isfinite(depth_m)
    ratio = np.where(hit, np.maximum(depth_m, NEAREST_M), FURTHEST_M) / NEAREST_M
    scale = np.log(ratio) / np.log(FURTHEST_M / NEAREST_M)
    return np.where(hit[..., None], turbo(1 - scale), np.uint8(0))


def difference_image(a: NDArray[np.float32], b: NDArray[np.float32]) -> Pixels:
    """How far two sRGB images (H, W, 3) are apart, channels averaged: black is equal, white `WHITE_DIFFERENCE` or more."""
    distance = np.abs(np.asarray(a, np.float32) - b).mean(-1) / WHITE_DIFFERENCE
    return np.repeat(bytes_from_srgb(distance)[..., None], 3, -1)


def sweep_image(
    points: FloatArray, intensity: NDArray[Any], width: int, height: int, metres_per_pixel: float = METRES_PER_PIXEL
) -> Pixels:
    """Points (N, 3) from above, x up and y left, the origin in the middle; brightness by intensity
    (N,), hue by height."""
    image = np.full((height, width, 3), BACKGROUND // 2, np.uint8)
    column = np.floor(width / 2 - points[:, 1] / metres_per_pixel).astype(np.int64)
    row = np.floor(height / 2 - points[:, 0] / metres_per_pixel).astype(np.int64)
    seen = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    order = np.argsort(points[seen, 2], kind="stable")  # what is higher is drawn last
    row, column = row[seen][order], column[seen][order]
    z, brightness = points[seen, 2][order], np.asarray(intensity)[seen][order]
    colours = turbo(0.15 + 0.7 * np.clip((z + 2.5) / 6, 0, 1))
    image[row, column] = (colours * (0.45 + 0.55 * np.clip(brightness, 0, 1))[:, None]).astype(np.uint8)
    return image


def outline(image: Pixels, mask: BoolArray, colour: tuple[int, int, int] = (255, 220, 0)) -> Pixels:
    """The image with the border of a mask (H, W) drawn into it."""
    inner = mask.copy()
    inner[1:] &= mask[:-1]
    inner[:-1] &= mask[1:]
    inner[:, 1:] &= mask[:, :-1]
    inner[:, :-1] &= mask[:, 1:]
    out = image.copy()
    out[mask & ~inner] = colour
    return out


@dataclass(frozen=True)
class CaptionedImage:
    """An image with words above it."""

    label: str
    pixels: Pixels


def sheet(rows: Sequence[Sequence[CaptionedImage]]) -> Pixels:
    """Rows of labelled images on one sheet (H, W, 3), each column as wide as its widest image."""
    columns = max(len(row) for row in rows)
    widths = [max((row[i].pixels.shape[1] for row in rows if i < len(row)), default=0) for i in range(columns)]
    heights = [LABEL_HEIGHT + max(tile.pixels.shape[0] for tile in row) for row in rows]
    image = Image.new(
        "RGB", (sum(widths) + GAP * (columns + 1), sum(heights) + GAP * (len(rows) + 1)), (BACKGROUND,) * 3
    )
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(size=13)
    top = GAP
    for row, height in zip(rows, heights, strict=True):
        left = GAP
        for tile, width in zip(row, widths, strict=False):
            draw.text((left + 2, top + 1), tile.label, fill=(235, 235, 235), font=font)
            image.paste(Image.fromarray(tile.pixels), (left, top + LABEL_HEIGHT))
            left += width + GAP
        top += height + GAP
    return np.asarray(image)


SWEEP_METRES_PER_PIXEL = 0.17


@dataclass(frozen=True)
class ReturnCloud:
    """Returned points (N, 3), world frame, and their intensity (N,)."""

    points: FloatArray
    intensity: NDArray[np.float32]


class CameraRow(NamedTuple):
    """One frame's images, side by side."""

    recorded: CaptionedImage
    replay: CaptionedImage
    edited: CaptionedImage
    truth: CaptionedImage
    difference: CaptionedImage


def camera_row(
    label: str,
    recorded: ImageArray | None,
    replay: ImageArray | None,
    edited: ImageArray,
    truth: ImageArray,
    region: BoolArray,
) -> CameraRow:
    """One frame's images (H, W, 3); the edited region (H, W) is outlined in the difference. What is
    None stays empty."""
    blank = np.zeros((*truth.shape[:2], 3), np.uint8)
    return CameraRow(
        CaptionedImage(f"{label}: recorded", blank if recorded is None else bytes_from_srgb(recorded)),
        CaptionedImage("replay", blank if replay is None else bytes_from_srgb(replay)),
        CaptionedImage("edited", bytes_from_srgb(edited)),
        CaptionedImage("truth of the edit", bytes_from_srgb(truth)),
        CaptionedImage("difference (white: 0.25)", outline(difference_image(edited, truth), region)),
    )


def sweep_tile(
    label: str,
    cloud: ReturnCloud,
    world_from_ego: FloatArray,
    size: tuple[int, int],
    metres_per_pixel: float = SWEEP_METRES_PER_PIXEL,
) -> CaptionedImage:
    """A sweep's returns from above, the vehicle in the middle and heading up; size is width, height."""
    local = transform_points(invert_pose(world_from_ego), cloud.points)
    return CaptionedImage(label, sweep_image(local, cloud.intensity, *size, metres_per_pixel))


def write_contact_sheet(path: Path, rows: Sequence[Sequence[CaptionedImage]]) -> None:
    """Write rows of images as one PNG. Raises `OutputError`."""
    write_file(path, png_bytes(sheet(rows)))
