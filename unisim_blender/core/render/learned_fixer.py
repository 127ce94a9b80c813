"""A fixer that is a small network, trained on views of procedural streets beside their ground truth, by
`benchmarks/learned_fixer.py`.

The network is a U-Net (Ronneberger et al., "U-Net: convolutional networks for biomedical image segmentation", 2015). It is
evaluated with NumPy, so that rendering needs no torch.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from .fixers import REFERENCES, ImageToFix
from .tracer import Array

WEIGHTS = Path(__file__).with_suffix(".npz")
LEVELS = 4
"""Number of sizes at which an image is seen, each half the one before."""
COARSEST = 2 ** (LEVELS - 1)
"""Pixels along an edge of the coarsest size's pixel."""
SLOPE = 0.1
"""Slope of the leaky rectifier below 0."""
DISTANCE = 5
"""Channel of the input that has the distance."""
FAR_M = 300.0
"""Distance, metres, that stands for what is hit nowhere."""
PART = 0.5
"""Part of what the network adds that is taken: all of it has less PSNR on streets that it was not trained on."""
SKY, SKY_RGB = 0.1, 0.1
"""Difference of a colour from the sky's, the largest of its channels, from which on pixels are fixed, and over which fixing
rises to all. What has the sky's colour stays: in scenes, sheets of it stand before the sky, which the network's streets lack."""
MARGIN = 64
"""Pixels around those to fix that the network is given, a multiple of the coarsest size's pixel."""


def network_input(view: ImageToFix) -> Array:
    """Return what the network is given (H, W, 16): colours, weight, filled part, distance, confidence, whether there is an
    actor, and of two recorded images warped colours and where they show the same surface."""
    depth = np.where(np.isfinite(view.depth_m), view.depth_m, FAR_M)
    maps = [view.image, view.weight, view.filled, np.log1p(depth) / 5, view.confidence, view.instance > 0]
    references = (*view.references, *view.references[-1:] * REFERENCES)[:REFERENCES]
    for reference in references:
        maps += [reference.warped * reference.shown[..., None], reference.shown]
    maps += [np.zeros((*depth.shape, 4))] * (REFERENCES - len(references))
    return np.concatenate([np.atleast_3d(each).astype(np.float32) for each in maps], axis=-1)


class LearnedFixer:
    """The fixer of ``--fill learned``."""

    name = "learned"

    def __call__(self, view: ImageToFix) -> Array:
        """Return the image (H, W, 3), fixed; colours are as they were far from the pixels to fix."""
        image = view.image.copy()
        rows, columns = (np.flatnonzero((view.weight > 0).any(axis)) for axis in (1, 0))
        window = tuple(
            slice(max(0, (some[0] - MARGIN) // COARSEST * COARSEST), some[-1] + 1 + MARGIN) for some in (rows, columns)
        )
        given = network_input(view)
        image[window] += part_of(given)[window] * added(given[window])
        return image


def part_of(given: Array) -> Array:
    """Return the part of what the network adds that is taken (H, W, 1), of its input (H, W, 16)."""
    colours, sky = given[..., :3], given[..., DISTANCE] >= np.float32(np.log1p(FAR_M) / 5)
    if not sky.any():
        return np.full((*sky.shape, 1), PART, np.float32)
    unlike = np.abs(colours - np.median(colours[sky], axis=0)).max(-1, keepdims=True)
    return np.float32(PART) * np.clip((unlike - np.float32(SKY)) / np.float32(SKY_RGB), 0, 1)


def added(given: Array) -> Array:
    """Return what the network adds to the colours (H, W, 3) of its input (H, W, 16)."""
    height, width = given.shape[:2]
    values = np.pad(given, ((0, -height % COARSEST), (0, -width % COARSEST), (0, 0)), mode="edge")
    finer = []
    for level in range(LEVELS):
        values = _block(f"d.{level}", values)
        if level < LEVELS - 1:
            finer.append(values)
            h, w, channels = values.shape
            values = values.reshape(h // 2, 2, w // 2, 2, channels).mean((1, 3))
    for level in range(LEVELS - 1):
        larger = values.repeat(2, 0).repeat(2, 1)
        values = _block(f"u.{level}", np.concatenate([larger, finer.pop()], axis=-1))
    return _convolved("o", values)[:height, :width]


@cache
def weights() -> dict[str, Array]:
    """Return the network's weights by name: those of convolutions (rows, columns, in, out), biases (out,)."""
    with np.load(WEIGHTS) as file:
        return {name: file[name].astype(np.float32) for name in file.files}


def _block(name: str, values: Array) -> Array:
    """Return the values of a residual block of two convolutions."""
    inner = _convolved(f"{name}.b", _rectified(_convolved(f"{name}.a", values)))
    return _rectified(inner + _convolved(f"{name}.k", values))


def _rectified(values: Array) -> Array:
    return np.maximum(values, np.float32(SLOPE) * values)


def _convolved(name: str, values: Array) -> Array:
    """Return the convolution of values (H, W, C), which are 0 around the image."""
    kernel, out = weights()[f"{name}.weight"], weights()[f"{name}.bias"]
    height, width, _ = values.shape
    around = len(kernel) // 2
    padded = np.pad(values, ((around, around), (around, around), (0, 0)))
    for row, column in np.ndindex(kernel.shape[:2]):
        out = out + padded[row : row + height, column : column + width] @ kernel[row, column]
    return out
