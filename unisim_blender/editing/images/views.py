"""Images of a view: parts that the worker sends, as the view stores them, and marks on images of frames outside the
drive. Numpy alone: a thread of the client calls it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.colour import bytes_from_srgb, linear_from_srgb
from ...core.world.drive import Drive
from ..sampled.clock import Clock
from ..texts import Text


@dataclass(frozen=True, eq=False)
class ViewPart:
    """A part of a view's image, at ``rows`` and ``columns`` of it, lowest row first.

    ``linear`` (H, W, 4) is premultiplied, ``srgb`` (H, W, 3) has eight bits, ``unsupported`` and ``confidence`` (H, W)
    are there where they were asked for, the latter of finished parts alone. ``bottom`` is the row, counted from the top,
    to which the image is finished; None for a coarse part.
    """

    rows: slice
    columns: slice
    linear: NDArray[np.float32]
    srgb: NDArray[np.uint8]
    unsupported: NDArray[np.bool_] | None
    confidence: NDArray[np.float32] | None
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
    right = arrays["confidence"][::-1] if finished and "confidence" in arrays else None
    return ViewPart(*here, whole, np.ascontiguousarray(srgb[::-1]), mask, right, bottom if finished else None)


DIMMED = 0.25
"""Factor on the linear colours of an image outside the drive."""
BAND_PX = 10
"""Width of its stripes and of the gaps between them, in pixels."""
BAND_GREY, BAND_ALPHA = 0.35, 0.5
"""Linear grey and opacity of its stripes."""


def outside_drive(frame: float, drive: Drive) -> str:
    """Return a sentence where ``frame`` lies before or after the drive, "" where it lies in it."""
    frames = Clock.of(drive).frames
    if frames[0] <= frame <= frames[-1]:
        return ""
    return Text(
        "Frame {frame:g} is outside the drive (frames {first:g} to {last:g}): nothing was recorded there",
        frame=float(frame), first=float(frames[0]), last=float(frames[-1]),
    )  # fmt: skip


def marked_outside(image: NDArray[np.float32], first_row: int = 0) -> NDArray[np.float32]:
    """Return a linear premultiplied image (H, W, 4) of a frame outside the drive, dimmed and with diagonal grey
    stripes; what is transparent stays so.

    ``first_row``: where in the whole image its rows begin, so that stripes go on from band to band.
    """
    height, width = image.shape[:2]
    rows = np.arange(first_row, first_row + height)[:, None]
    alpha = np.where((rows + np.arange(width)) // BAND_PX % 2 == 0, np.float32(BAND_ALPHA), np.float32(0.0))[..., None]
    out = image.copy()
    out[..., :3] = (1 - alpha) * DIMMED * image[..., :3] + alpha * BAND_GREY * image[..., 3:]
    return out


def stripes(width: float, height: float, band: float) -> NDArray[np.float32]:
    """Return the corners (6 N, 2) of triangles that are diagonal stripes over a region, ``band`` wide
    and so far apart."""
    left = np.arange(0, width + height, 2 * band)
    two = ((0, 0), (band, 0), (-height, height), (band, 0), (band - height, height), (-height, height))
    corners = np.tile(np.array(two, np.float32), (len(left), 1, 1))
    corners[..., 0] += left[:, None]
    return corners.reshape(-1, 2)
