"""One image, and links to it: a drive of thousands of images that takes no more place than one."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
from PIL import Image

SIZE = (1920, 1080)


def picture(kind: str, size: tuple[int, int] = SIZE, quality: int = 80) -> bytes:
    """Return an image file of a size (width, height), "JPEG" or "PNG": soft noise, which packs about as photographs do."""
    noise = np.random.default_rng(0).integers(0, 256, (size[1] // 8, size[0] // 8, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(noise).resize(size, Image.Resampling.BICUBIC).save(buffer, kind, quality=quality)
    return buffer.getvalue()


def link(source: Path, target: Path) -> None:
    """Give a file another name, in a folder that is made where it is not there."""
    target.parent.mkdir(parents=True, exist_ok=True)
    os.link(source, target)
