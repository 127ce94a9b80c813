"""Images as files of other layouts: bytes are kept where the layout has files of their kind."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...data.images import SIGNATURES, encoded_image
from ...data.log import Log
from ...errors import OutputError, in_a_line
from ...world.drive import CameraModel
from .rectify import Rectification

JPEG_QUALITY = 95


def image_file(log: Log, camera: str, frame: int, kind: str, rectification: Rectification | None = None) -> bytes:
    """Return an image's file of a ``kind``, "jpeg" or "png": the log's own bytes where they are of it and nothing is rectified.

    Raises `LogError`, `OutputError`.
    """
    content = encoded_image(log, camera, frame) if rectification is None else log.image(camera, frame)
    if isinstance(content, bytes):
        found = next(form for begin, form in SIGNATURES.items() if content.startswith(begin))
        if found == kind:
            _check_size(content, log.drive.cameras[camera].model, f"{log.path}: {camera}'s image of frame {frame}")
            return content
        content = log.image(camera, frame)
    return encode(content if rectification is None else rectification.image(content), kind)


def encode(rgb: NDArray[np.uint8], kind: str) -> bytes:
    """Return an image (H, W, 3) as a file's bytes."""
    buffer = io.BytesIO()
    if kind == "png":
        Image.fromarray(rgb).save(buffer, "PNG")
    else:
        Image.fromarray(rgb).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return buffer.getvalue()


def path_kind(path: Path | None) -> str:
    """Return "jpeg" or "png" for a file of that suffix, "" for another."""
    return {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}.get("" if path is None else path.suffix.lower(), "")


def _check_size(content: bytes, model: CameraModel, where: str) -> None:
    try:
        with Image.open(io.BytesIO(content)) as image:
            found = image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as fault:
        raise OutputError(f"{where} is broken ({in_a_line(fault)})") from fault
    if found != (model.width, model.height):
        raise OutputError(f"{where} has {found[0]}x{found[1]} pixels, not {model.width}x{model.height}")
