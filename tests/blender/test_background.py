"""What runs in the background, as it is shown."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from unisim_blender.editing.layout.chart import HEIGHT, WIDTH, training_chart
from unisim_blender.process.background import CURVE, show_curve


def entry(seconds: float, psnr: float, lidar_m: float) -> dict[str, float]:
    """A line of training.jsonl."""
    return {"seconds": seconds, "psnr": psnr, "lidar_m": lidar_m}


def test_the_curve_is_an_image_that_follows(scene: Any) -> None:
    for count in (2, 4):
        chart = training_chart(
            [entry(60.0 * minute, 15.0 + minute, 1.0 / minute) for minute in range(1, 1 + count)], 10.0
        )
        show_curve(chart)
        (image,) = [image for image in bpy.data.images if image.name.startswith(CURVE)]
        pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
        image.pixels.foreach_get(pixels)
        shown = pixels.reshape(2 * HEIGHT, WIDTH, 4)[::-1, :, :3]
        assert np.abs(shown - chart).max() < 1 / 255
        assert not image.is_dirty
        assert tuple(image.preview.image_size) == (WIDTH, 2 * HEIGHT)
