"""Parts of a rendered image, as the worker sends them, made into what a view keeps. Numpy alone: the
client's thread does it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.colour import bytes_from_srgb, linear_from_srgb


@dataclass(frozen=True, eq=False)
class ViewPart:
    """A part of a view's image, at ``rows`` and ``columns`` of it, lowest row first.

    ``linear`` (H, W, 4) is premultiplied, ``srgb`` (H, W, 3) has eight bits, ``unsupported`` (H, W) is there where it
    was asked for. ``bottom`` is the row, counted from the top, to which the image is finished; None for a coarse part.
    """

    rows: slice
    columns: slice
    linear: NDArray[np.float32]
    srgb: NDArray[np.uint8]
    unsupported: NDArray[np.bool_] | None
    bottom: int | None


def view_part(event: dict[str, Any], arrays: dict[str, NDArray[Any]], size: tuple[int, int], clip: bool) -> ViewPart:
    """Return the part that an ``arrays`` event of the worker brings, of an image of that size (height, width).

    Each pixel of a coarse part stands for those about it. With ``clip`` what is unsupported is transparent.
    """
    (top, bottom), (left, right) = event["rows"], event["columns"]
    rgb, unsupported = np.clip(arrays["rgb"], 0, 1), arrays.get("unsupported")
    linear, srgb, finished = linear_from_srgb(rgb), bytes_from_srgb(rgb), event["stride"] == [1, 1]
    if not finished:
        places = zip(((top, bottom), (left, right)), event["origin"], event["stride"], linear.shape, strict=False)
        rows, columns = (
            np.clip(np.rint((np.arange(*span) - first) / stride).astype(int), 0, count - 1)
            for span, first, stride, count in places
        )
        linear, srgb = linear[rows[:, None], columns], srgb[rows[:, None], columns]
        unsupported = None if unsupported is None else unsupported[rows[:, None], columns]
    whole = np.ones((bottom - top, right - left, 4), np.float32)
    whole[..., :3] = linear[::-1]
    mask = None if unsupported is None else np.ascontiguousarray(unsupported[::-1], bool)
    if clip and mask is not None:
        whole[mask] = 0.0
    here = slice(size[0] - bottom, size[0] - top), slice(left, right)
    return ViewPart(*here, whole, np.ascontiguousarray(srgb[::-1]), mask, bottom if finished else None)
