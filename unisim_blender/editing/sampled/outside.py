"""Frames before and after the drive: nothing was recorded there, and an image of such a frame is marked all over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...core.world.drive import Drive
from ..texts import Text
from .clock import Clock

DIMMED = 0.25
"""Factor on the linear colours of an image outside the drive."""
BAND_PX = 10
"""How wide its stripes are, and how far they are apart."""
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
