"""Recorded images at the size that is trained and measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..world.drive import CameraModel


def resize_image(rgb: NDArray[np.uint8], model: CameraModel) -> NDArray[np.uint8]:
    """An image (H, W, 3) at the camera model's size, each new pixel the mean of what it covers."""
    if rgb.shape[:2] == (model.height, model.width):
        return rgb
    return np.asarray(Image.fromarray(rgb).resize((model.width, model.height), Image.Resampling.BOX))
