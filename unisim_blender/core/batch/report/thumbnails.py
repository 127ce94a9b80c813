"""Small images of variants, as data URIs."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from PIL import Image, UnidentifiedImageError

from ..store import Store

SIZE = 128, 72
"""The most pixels of one of them, in width and in height."""
QUALITY = 70
MOST = 2000
"""Variants with thumbnails; a page with more of them would open slowly."""
THREADS = 8


def thumbnails(store: Store, images: Sequence[Sequence[str]]) -> list[str]:
    """Return for each variant its images side by side as a JPEG's data URI; "" where it has none that can be read.

    ``images`` are names of objects. Variants after the first `MOST` have none. Raises `OutputError`.
    """
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(lambda names: _strip(store, names), images[:MOST]))
    return found + [""] * (len(images) - len(found))


def _strip(store: Store, names: Sequence[str]) -> str:
    small = [image for name in names if (image := _small(store.read(name))) is not None]
    if not small:
        return ""
    strip = Image.new("RGB", (sum(image.width for image in small), max(image.height for image in small)))
    left = 0
    for image in small:
        strip.paste(image, (left, 0))
        left += image.width
    file = io.BytesIO()
    strip.save(file, "JPEG", quality=QUALITY, optimize=True)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"


def _small(data: bytes | None) -> Image.Image | None:
    if data is None:
        return None
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            small = image.convert("RGB")
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError):
        return None  # it is damaged: the batch says so where it resumes
    small.thumbnail(SIZE, Image.Resampling.BOX)
    return small
