"""Recorded images at the size that is trained and measured, and as the files that they are."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import LogError
from ..geometry import BoolArray
from ..sensors.unprojection import image_mask
from ..world.drive import CameraModel
from .log import Log

SIGNATURES = {b"\xff\xd8\xff": "jpeg", b"\x89PNG": "png"}
"""How files of images begin that are taken over as they are."""
_ROWS = 32


def rgb_pixels(image: Image.Image) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) of an image that Pillow opened, sRGB.

    Rows are copied a few at a time, which stay in a processor's cache: all at once take as long as decoding them.
    """
    pixels = np.empty((image.height, image.width, 3), np.uint8)
    for row in range(0, image.height, _ROWS):
        part = image.crop((0, row, image.width, min(row + _ROWS, image.height)))
        pixels[row : row + _ROWS] = part if part.mode == "RGB" else part.convert("RGB")
    return pixels


def resize_image(rgb: NDArray[np.uint8], model: CameraModel) -> NDArray[np.uint8]:
    """An image (H, W, 3) at the camera model's size, each new pixel the mean of what it covers."""
    if rgb.shape[:2] == (model.height, model.width):
        return rgb
    return np.asarray(Image.fromarray(rgb).resize((model.width, model.height), Image.Resampling.BOX))


@lru_cache(maxsize=16)
def shown_pixels(recorded: CameraModel, model: CameraModel) -> BoolArray | None:
    """Pixels (H, W) of a recorded image at ``model``'s size that have their colour from what the lens shows alone; None where all
    have. At the border of what it shows, a pixel of a resized image covers some that are black."""
    shown, own = image_mask(model), image_mask(recorded)
    if own is None or own.shape == (model.height, model.width):
        return shown
    covered = resize_image(np.repeat(np.uint8(255) * own[..., None], 3, 2), model)[..., 0] == 255
    mask = covered if shown is None else covered & shown
    mask.flags.writeable = False
    return mask


def encoded_image(log: Log, camera: str, frame: int) -> NDArray[np.uint8] | bytes:
    """A recorded image's file as it is where it is a JPEG or PNG; its pixels (H, W, 3) otherwise. Raises `LogError`."""
    encoded = getattr(log, "encoded_image", None)
    if encoded is not None:
        return bytes(encoded(camera, frame))
    path = log.image_path(camera, frame)
    if path is None:
        return log.image(camera, frame)
    try:
        content = path.read_bytes()
    except OSError as fault:
        raise LogError(f"{path}: cannot be read ({fault.strerror})") from fault
    return content if content.startswith(tuple(SIGNATURES)) else log.image(camera, frame)
