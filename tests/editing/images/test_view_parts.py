"""Parts of a rendered image as a view keeps them, beside the same worked out pixel by pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.editing.images.views import view_part

SIZE = 13, 22
CASES = {
    "band": ((1, 1), (3, 0), (6, 22), (3, 9), (0, 22)),
    "coarse": ((4, 4), (0, 0), (4, 6), (0, 13), (0, 22)),
    "coarse part": ((2, 4), (5, 3), (3, 2), (5, 10), (3, 8)),
}
"""Stride, origin, shape, rows and columns of parts, as the worker tells them."""


def linear(value: float) -> float:
    """A colour of sRGB in linear light."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def plain(event: dict[str, Any], arrays: dict[str, NDArray[Any]], clip: bool) -> tuple[NDArray[Any], ...]:
    """Colours (H, W, 4), eight bits (H, W, 3) and unsupported pixels (H, W) of a whole image, top row first, -1
    where nothing came."""
    colours, eight, lacking = np.full((*SIZE, 4), -1.0), np.full((*SIZE, 3), -1), np.full(SIZE, -1)
    (top, bottom), (left, right) = event["rows"], event["columns"]
    for y in range(top, bottom):
        for x in range(left, right):
            at = []
            for pixel, first, stride, count in zip(
                (y, x), event["origin"], event["stride"], arrays["rgb"].shape, strict=False
            ):
                at.append(min(max(int(np.rint((pixel - first) / stride)), 0), count - 1))
            rgb = [min(max(float(value), 0.0), 1.0) for value in arrays["rgb"][tuple(at)]]
            eight[y, x] = [int(value * 255 + 0.5) for value in rgb]
            lacking[y, x] = arrays["unsupported"][tuple(at)]
            colours[y, x] = 0.0 if clip and lacking[y, x] else [*map(linear, rgb), 1.0]
    return colours, eight, lacking


@pytest.mark.parametrize("clip", (False, True))
@pytest.mark.parametrize("name", CASES)
def test_a_part_is_what_each_pixel_says(name: str, clip: bool) -> None:
    stride, origin, shape, rows, columns = CASES[name]
    draw = np.random.default_rng(2)
    arrays: dict[str, NDArray[Any]] = {
        "rgb": draw.uniform(-0.1, 1.1, (*shape, 3)).astype(np.float32),
        "unsupported": draw.uniform(size=shape) < 0.4,
    }
    event = {"rows": list(rows), "columns": list(columns), "origin": list(origin), "stride": list(stride)}
    part = view_part(event, arrays, SIZE, clip)
    assert part.bottom == (rows[1] if stride == (1, 1) else None)
    wanted = plain(event, arrays, clip)
    found = np.full((*SIZE, 4), -1.0), np.full((*SIZE, 3), -1), np.full(SIZE, -1)
    assert part.unsupported is not None
    for whole, piece in zip(found, (part.linear, part.srgb, part.unsupported), strict=True):
        whole[part.rows, part.columns] = piece
    for ours, theirs, off in zip(found, wanted, (1e-6, 1, 0), strict=True):
        assert np.abs(ours[::-1] - theirs).max() <= off
    # a value halfway between two of eight bits may be rounded to either
    assert (found[1][::-1] != wanted[1]).mean() < 0.01


def test_nothing_is_clipped_where_nothing_says_so() -> None:
    event = {"rows": [0, 2], "columns": [0, 2], "origin": [0, 0], "stride": [1, 1]}
    part = view_part(event, {"rgb": np.zeros((2, 2, 3), np.float32)}, SIZE, True)
    assert part.unsupported is None and (part.linear[..., 3] == 1).all()
