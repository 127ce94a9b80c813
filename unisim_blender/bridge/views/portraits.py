"""An image of one actor: from where it was recorded best, cut out of its surroundings."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray


def set_preview(obj: bpy.types.Object, rgb: NDArray[np.float32], shown: NDArray[np.bool_]) -> None:
    """Give an asset an image (H, W, 3) of display-referred sRGB, see-through where ``shown`` (H, W) is False."""
    rgba = np.concatenate([rgb, shown[..., None].astype(np.float32)], -1)[::-1]
    preview = obj.preview_ensure()
    preview.image_size = rgba.shape[1], rgba.shape[0]
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(rgba, np.float32).ravel())
