"""An actor cut out of a recorded image, as a square thumbnail in which what is not the actor is dimmed."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from .best_views import ActorView

SIZE_PX = 192
MARGIN = 1.25
"""Edge of the square beside the longer edge of the actor's rectangle."""
DIMMED = 0.55
"""Brightness of what lies outside the actor's rectangle."""
LEAST_PX = 24
"""A smaller square would show blocks and no surroundings."""


def crop(image: NDArray[np.uint8], view: ActorView) -> NDArray[np.uint8]:
    """Return a square (`SIZE_PX`, `SIZE_PX`, 3) of an image (H, W, 3) around an actor, kept inside the
    image where it fits."""
    from PIL import Image

    height, width = image.shape[:2]
    left, top, right, bottom = view.rectangle
    edge = min(max(MARGIN * max(right - left, bottom - top), LEAST_PX), width, height)
    x = float(np.clip((left + right - edge) / 2, 0, width - edge))
    y = float(np.clip((top + bottom - edge) / 2, 0, height - edge))
    part = Image.fromarray(image).resize((SIZE_PX, SIZE_PX), Image.Resampling.BICUBIC, box=(x, y, x + edge, y + edge))
    pixels = np.asarray(part, np.float32)
    u, v = (x + (np.arange(SIZE_PX) + 0.5) * edge / SIZE_PX, y + (np.arange(SIZE_PX) + 0.5) * edge / SIZE_PX)
    room = 0.03 * edge
    inside = ((v >= top - room) & (v <= bottom + room))[:, None] & ((u >= left - room) & (u <= right + room))
    return np.asarray(np.where(inside[..., None], pixels, pixels * DIMMED), np.uint8)


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Return an image (H, W, 3) or (H, W, 4) as a PNG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()
