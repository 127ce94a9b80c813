"""An image traced where it must be: first pixels on a lattice, and in between only where those at a
block's corners differ.

What lies between corners that are alike is interpolated: colours as they are, depths as disparities, which are linear
on planes. Where they differ a little, the pixel in a block's middle is traced too, and if it is what the corners
predict, the block is left at that. A block is decided on by its own pixels alone, so a part of an image that begins on
the lattice has the whole's bits. An image can be looked at while it grows: what is traced of it at first, every eighth
pixel say, is what is traced of it at last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..tracer import SIDE, Array, Maps
from .blocks import Blocks, SparseImage, differ, fill, predicted

Trace = Callable[[NDArray[np.int64]], tuple[Array, Maps]]
"""Colours (N, 3) and maps (N, ...) of pixels by their flat numbers."""


def aligned(cells: tuple[slice, slice], size: int, shape: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of an image of that shape (h, w), dilated to where a lattice of ``size`` begins and ends.

    With a block before those that begin on its lines: it may have these traced.
    """
    rows, columns = (
        slice(max(0, part.start - 1) // size * size, min(end, ((part.stop - 1) // size + 1) * size + 1))
        for part, end in zip(cells, shape, strict=True)
    )
    return rows, columns


def progressive_strides(
    image: SparseImage, size: int, spread: float, trace: Trace, coarse: Sequence[int] = (), band: int | None = None
) -> Iterator[tuple[int, slice]]:
    """Fills an image from a lattice of ``size``, a power of two, and says what there is of it: a stride and rows.

    ``spread`` is by how much colours may differ between the corners of what is interpolated. First every stride-th
    pixel of every stride-th row, for those strides of ``coarse`` that are multiples of ``size``; then, with stride 1,
    finished bands of ``band`` rows or a few less, from the top.
    """
    h, w = image.shape
    last = (h - 1) // size * size, (w - 1) // size * size
    for stride in coarse:
        if stride > size and stride % size == 0:
            _take(image, _numbers(np.arange(0, h, stride), np.arange(0, w, stride), w), stride, trace)
            yield stride, slice(0, h)
    step = h if band is None else max(size, band // size * size)
    for top in range(0, h, step):
        bottom = min(top + step, h)
        wanted = np.zeros((min(bottom + 1, h) - top, w), bool)
        # the next band's first line has corners of this one's blocks
        wanted[0 : last[0] + 1 - top : size, 0 : last[1] + 1 : size] = True
        # on the last lines and beyond them no block begins
        wanted[: bottom - top, last[1] :] = True
        wanted[max(0, last[0] - top) : bottom - top] = True
        _take(image, np.flatnonzero(wanted) + top * w, size, trace)
        y, x = np.mgrid[top : min(bottom, last[0]) : size, 0 : last[1] : size]
        _refine(image, np.stack([y.reshape(-1), x.reshape(-1)], 1), size, spread, trace)
        yield 1, slice(top, bottom)


def _refine(image: SparseImage, blocks: Blocks, size: int, spread: float, trace: Trace) -> None:
    """Fills blocks whose corners are known. Those above and to the left are full, or here too."""
    leaves, w = [], image.shape[1]
    while size > 1 and len(blocks):
        half = size // 2
        apart, doubtful = differ(image, blocks, size, spread)
        _take(image, (blocks[doubtful] + half) @ np.array([w, 1]), half, trace)
        apart[doubtful] = ~predicted(image, blocks[doubtful], size, spread)
        leaves.append((blocks[~apart], size))
        blocks = blocks[apart]
        first, steps = (
            blocks[:, 0] * w + blocks[:, 1],
            np.array([half, half * w, half * w + half, size * w + half, half * w + size]),
        )
        wanted = np.zeros(image.known.size, bool)
        for step in steps:
            wanted[first + step] = True
        _take(image, np.flatnonzero(wanted), half, trace)
        blocks = np.concatenate([blocks + step for step in ((0, 0), (0, half), (half, 0), (half, half))])
        size = half
    for blocks, size in leaves:
        fill(image, blocks, size)


def _numbers(rows: NDArray[np.int64], columns: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """Flat numbers of the pixels in rows and columns."""
    numbers: NDArray[np.int64] = (rows[:, None] * width + columns).reshape(-1)
    return numbers


def _take(image: SparseImage, numbers: NDArray[np.int64], stride: int, trace: Trace) -> None:
    """Traces those of the pixels that are not known, which lie about ``stride`` apart; neighbours together."""
    known = image.known.reshape(-1)
    numbers = numbers[~known[numbers]]
    if len(numbers) == 0:
        return
    side, width = SIDE * stride, image.shape[1]
    y, x = np.divmod(numbers, width)
    tile = y // side * (width // side + 1) + x // side
    # numpy counts what fits in sixteen bits, and merges the rest
    numbers = numbers[np.argsort(tile.astype(np.uint16) if tile.max() < 1 << 16 else tile, kind="stable")]
    rgb, maps = trace(numbers)
    image.put(numbers, {"rgb": rgb, **maps})
    known[numbers] = True
