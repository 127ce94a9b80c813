"""Curves as an image, made with numpy alone: Blender has no charts, and draws nothing without a window."""

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
DOT = 2
"""Pixels of a letter's dot."""
LETTERS = {
    "0": "75557", "1": "26227", "2": "71747", "3": "71317", "4": "55711", "5": "74717", "6": "74757", "7": "71222",
    "8": "75757", "9": "75717", ".": "00002", "A": "25755", "D": "65556", "L": "44447", "N": "65555", "P": "75744",
    "R": "65655", "S": "34216", "B": "65656", "c": "00747", "d": "11757", "i": "20222", "m": "00775", "n": "00755",
}  # fmt: skip
"""Five rows of three dots, from the top, each row's dots as a number's bits. Others are blank."""

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
        write(image, f"{value:g}", column, bottom + 8, centred=True)
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
            text = f"{value:g}"
            write(image, text, LEFT - 6 - 4 * DOT * len(text), at - 5)
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


def write(image: ChartImage, text: str, left: int, top: int, centred: bool = False) -> None:
    """Put a line of text into an image (H, W, 3)."""
    left -= 2 * DOT * len(text) if centred else 0
    for i, letter in enumerate(text):
        dots = np.array([[int(row) >> (2 - bit) & 1 for bit in range(3)] for row in LETTERS.get(letter, "00000")], bool)
        place = image[top : top + 5 * DOT, left + 4 * DOT * i :][:, : 3 * DOT]
        shape = np.kron(dots, np.ones((DOT, DOT), bool))
        place[shape[: place.shape[0], : place.shape[1]]] = INK
