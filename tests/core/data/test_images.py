"""Pixels of recorded images, as every reader takes them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from unisim_blender.core.data.images import rgb_pixels


@pytest.mark.parametrize("mode", ["RGB", "L", "P", "RGBA", "CMYK", "1"])
@pytest.mark.parametrize("height", [1, 31, 32, 75])
def test_pixels_are_those_that_pillow_gives(mode: str, height: int) -> None:
    rgb = np.random.default_rng(height).integers(0, 256, (height, 45, 3), np.uint8)
    image = Image.fromarray(rgb).convert(mode)
    np.testing.assert_array_equal(rgb_pixels(image), np.asarray(image.convert("RGB")))
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, "PNG")
    with Image.open(file) as image:
        np.testing.assert_array_equal(rgb_pixels(image), rgb)


def test_a_file_that_is_cut_off_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "cut.jpg"
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (200, 300, 3), np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:-20000])
    with Image.open(path) as image, pytest.raises(OSError, match="truncated"):
        rgb_pixels(image)
