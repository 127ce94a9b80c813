"""Recorded images at the size that is trained and measured."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..geometry import BoolArray
from ..sensors.unprojection import image_mask
from ..world.drive import CameraModel


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
