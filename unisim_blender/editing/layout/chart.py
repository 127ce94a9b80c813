"""Curves as an image, made without Blender: it has no charts, and draws nothing without a window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...core.geometry import FloatArray

WIDTH, HEIGHT = 480, 170
"""Of one chart, in pixels."""
LEFT, RIGHT, TOP, BOTTOM = 52, 16, 28, 24
"""Margins round its axes."""
PAPER, GRID, INK = 0.11, 0.24, 0.80
PSNR, LIDAR = (1.0, 0.72, 0.25), (0.35, 0.78, 1.0)
"""Curves' colours, sRGB."""
LETTERS_PX = 13
"""Size of the letters."""

ChartImage = NDArray[np.float32]


def training_chart(entries: Sequence[Mapping[str, float]], minutes: float) -> ChartImage:
    """PSNR and LiDAR error over a training's minutes, (H, W, 3) sRGB. ``entries`` are of training.jsonl; ``minutes`` is
    how long it is to take."""
    latest: list[Mapping[str, float]] = []
    for entry in reversed(
        entries
    ):  # a training that was resumed has gone through some steps twice: the later ones count
        if not latest or entry["seconds"] < latest[-1]["seconds"]:
            latest.append(entry)
    table = np.array(
        [[entry[name] for name in ("seconds", "psnr", "lidar_m")] for entry in latest[::-1]], float
    ).reshape(-1, 3)
    x, psnr, lidar_cm = table[:, 0] / 60, table[:, 1], table[:, 2] * 100.0
    end = max([minutes, *x])
    return np.concatenate(
        [chart("PSNR dB", x, psnr, end, PSNR), chart("LiDAR cm", x, lidar_cm, end, LIDAR, powers=True)]
    )


def chart(
    title: str, x: FloatArray, y: FloatArray, end: float, colour: Sequence[float], powers: bool = False
) -> ChartImage:
    """One curve, points (N,) by (N,), over minutes from 0 to ``end``: (HEIGHT, WIDTH, 3). ``powers``: y
    by its logarithm."""
    image = np.full((HEIGHT, WIDTH, 3), PAPER, np.float32)
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
    write(image, title, LEFT, TOP // 2 - 5)
    image[bottom, LEFT:right] = image[TOP:bottom, LEFT] = INK
    for value in ticks(0.0, end):
        column = round(LEFT + (right - 1 - LEFT) * value / end)
        image[bottom : bottom + 4, column] = INK
        write(image, f"{value:g}", column, bottom + 8, "mt")
    write(image, "min", right - 24, TOP // 2 - 5)
    finite = np.isfinite(y) & ((y > 0) | (not powers))
    x, y = x[finite], y[finite]
    if not len(y):
        return image
    scale = np.log10 if powers else np.asarray
    low, high = float(scale(y.min())), float(scale(y.max()))
    middle, half = (low + high) / 2, max((high - low) / 2 * 1.08, 0.05 if powers else 0.5)

    def row(value: FloatArray) -> FloatArray:
        return bottom - (bottom - TOP) * (scale(value) - middle + half) / (2 * half)

    marks = decades(middle - half, middle + half) if powers else ticks(middle - half, middle + half)
    for value in marks:
        at = round(float(row(np.array(value))))
        if TOP <= at < bottom:
            image[at, LEFT + 1 : right] = GRID
            write(image, f"{value:g}", LEFT - 6, at, "rm")
    columns = np.arange(LEFT + 1, right)
    at_x = (columns - LEFT) / (right - 1 - LEFT) * end
    step = end / (right - LEFT)
    rows = row(np.interp(at_x, x, y))
    for i in np.flatnonzero((at_x >= x[0] - step) & (at_x <= x[-1] + step)):
        first, last = sorted((rows[max(i - 1, 0)] if at_x[i] > x[0] + step else rows[i], rows[i]))
        image[max(TOP, round(first) - 1) : min(bottom, round(last) + 1), columns[i]] = colour
    return image


def ticks(low: float, high: float) -> list[float]:
    """Round numbers between two, some three to seven."""
    rough = (high - low) / 4
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * min((1, 2, 5, 10), key=lambda factor: abs(factor * power - rough))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(f"{i * step:.6g}") for i in range(first, last + 1)]


def decades(low: float, high: float) -> list[float]:
    """1, 2 and 5 times the powers of ten between 10**low and 10**high; of a wide range the powers alone."""
    factors = (1, 2, 5) if high - low < 2 else (1,)
    values = [factor * 10.0**power for power in range(int(np.floor(low)), int(np.ceil(high)) + 1) for factor in factors]
    return [value for value in values if 10**low <= value <= 10**high]


def write(image: ChartImage, text: str, left: int, top: int, anchor: str = "lt") -> None:
    """Put a line of text into an image (H, W, 3); ``anchor`` says, as Pillow has it, which point of the text is given."""
    from PIL import Image, ImageDraw, ImageFont

    page = Image.new("L", (image.shape[1], image.shape[0]))
    ImageDraw.Draw(page).text((left, top), text, 255, ImageFont.load_default(LETTERS_PX), anchor)
    share = np.asarray(page, np.float32)[..., None] / 255
    image += share * (INK - image)
