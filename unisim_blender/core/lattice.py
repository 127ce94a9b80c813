"""A picture traced where it must be: first pixels on a lattice, and in between only where those at a block's corners differ.

What lies between corners that are alike is interpolated: colours as they are, depths as disparities, which are linear on planes.
A block is decided on by its own corners alone, so a part of a picture that begins on the lattice has the whole picture's bits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .tracer import Array, Maps

DISPARITY_RANGE = 0.1
"""Depths at corners that differ by more than this share lie on several things, or on one that bends."""
DISPARITY_TWIST = 0.01
"""So far may the corners' disparities be from one plane, as a share of the largest."""
Blocks = NDArray[np.int64]
"""Rows and columns of blocks' first pixels (N, 2)."""
Trace = Callable[[NDArray[np.int64]], tuple[Array, Maps]]
"""Colours (N, 3) and maps (N, ...) of pixels by their flat numbers."""


@dataclass
class Picture:
    """Colours (h w, 3) and maps (h w, ...), and which pixels (h, w) were traced."""

    shape: tuple[int, int]
    known: NDArray[np.bool_] = field(init=False)
    values: Maps = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.known = np.zeros(self.shape, bool)

    def put(self, numbers: NDArray[np.int64], found: Maps) -> None:
        """Values at pixels by their flat numbers."""
        for name, part in found.items():
            if name not in self.values:
                self.values[name] = np.zeros((self.shape[0] * self.shape[1], *part.shape[1:]), part.dtype)
            self.values[name][numbers] = part

    def corners(self, name: str, blocks: Blocks, size: int) -> NDArray[Any]:
        """Values (4, N, ...) at the corners of blocks."""
        y, x = blocks.T
        number = y * self.shape[1] + x
        steps = np.array([0, size, size * self.shape[1], size * self.shape[1] + size])
        return self.values[name][steps[:, None] + number]


def aligned(cells: tuple[slice, slice], size: int, shape: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a picture of that shape (h, w), widened to where a lattice of ``size`` begins and ends.

    With a block before those that begin on its lines: it may have these traced.
    """
    rows, columns = (
        slice(max(0, part.start - 1) // size * size, min(end, ((part.stop - 1) // size + 1) * size + 1))
        for part, end in zip(cells, shape, strict=True)
    )
    return rows, columns


def traced(shape: tuple[int, int], size: int, spread: float, order: NDArray[np.int64], trace: Trace) -> tuple[Array, Maps]:
    """Colours (h w, 3) and maps of a picture of pixels (h, w), from a lattice of ``size``, a power of two.

    ``spread`` is by how much colours may differ between the corners of what is interpolated; ``order`` (h w,) are the pixels'
    numbers, neighbours together.
    """
    h, w = shape
    picture = Picture(shape)
    last = (h - 1) // size * size, (w - 1) // size * size
    wanted = np.zeros(shape, bool)
    wanted[0 : last[0] + 1 : size, 0 : last[1] + 1 : size] = True
    # on the last lines and beyond them no block begins
    wanted[last[0] :] = wanted[:, last[1] :] = True
    _take(picture, wanted, order, trace)
    y, x = np.mgrid[0 : last[0] : size, 0 : last[1] : size]
    blocks = np.stack([y.reshape(-1), x.reshape(-1)], 1)
    leaves = []
    while size > 1 and len(blocks):
        apart = _differ(picture, blocks, size, spread)
        leaves.append((blocks[~apart], size))
        blocks, half = blocks[apart], size // 2
        wanted[:] = False
        for step in ((0, half), (half, 0), (half, half), (size, half), (half, size)):
            wanted[tuple((blocks + step).T)] = True
        _take(picture, wanted & ~picture.known, order, trace)
        blocks = np.concatenate([blocks + step for step in ((0, 0), (0, half), (half, 0), (half, half))])
        size = half
    for blocks, size in leaves:
        _fill(picture, blocks, size)
    return picture.values.pop("rgb"), picture.values


def _take(picture: Picture, wanted: NDArray[np.bool_], order: NDArray[np.int64], trace: Trace) -> None:
    numbers = order[wanted.reshape(-1)[order]]
    if len(numbers) == 0:
        return
    rgb, maps = trace(numbers)
    picture.put(numbers, {"rgb": rgb, **maps})
    picture.known |= wanted


def _differ(picture: Picture, blocks: Blocks, size: int, spread: float) -> NDArray[np.bool_]:
    """Which blocks (N,) have corners that are not alike."""
    rgb = picture.corners("rgb", blocks, size)
    apart = (rgb.max(0) - rgb.min(0)).max(1) > spread
    for name in ("instance", "support"):
        if name in picture.values:
            values = picture.corners(name, blocks, size)
            apart |= (values != values[0]).any(0)
    if "depth" in picture.values:
        disparity = 1 / picture.corners("depth", blocks, size)
        largest = disparity.max(0)
        twist = np.abs(disparity[0] + disparity[3] - disparity[1] - disparity[2])
        apart |= (largest - disparity.min(0) > DISPARITY_RANGE * largest) | (twist > DISPARITY_TWIST * largest)
    return apart


def _fill(picture: Picture, blocks: Blocks, size: int) -> None:
    """Values in blocks whose corners are alike, at pixels that were not traced."""
    steps = np.arange(size, dtype=np.float32) / np.float32(size)
    v, u = (x.reshape(-1, 1) for x in np.meshgrid(steps, steps, indexing="ij"))
    weights = np.stack([(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u])
    y, x = blocks.T
    inner = (np.arange(size)[:, None] * picture.shape[1] + np.arange(size)).reshape(-1, 1)
    numbers = inner + (y * picture.shape[1] + x)
    unknown = ~picture.known.reshape(-1)[numbers]
    numbers = numbers[unknown]
    for name, values in picture.values.items():
        corners = picture.corners(name, blocks, size)
        if values.dtype.kind != "f":
            # alike in all four
            values[numbers] = np.broadcast_to(corners[0], unknown.shape)[unknown]
            continue
        at = 1 / corners if name == "depth" else corners
        mixed = sum(w.reshape(-1, *(1,) * (at.ndim - 1)) * c for w, c in zip(weights, at, strict=True))[unknown]
        if name == "normal":
            mixed /= np.maximum(np.linalg.norm(mixed, axis=-1, keepdims=True), 1e-12)
        with np.errstate(divide="ignore"):
            values[numbers] = 1 / mixed if name == "depth" else mixed
