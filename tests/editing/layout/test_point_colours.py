"""Colours of LiDAR points."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.editing.layout.shapes import GREY, number_colours


def test_numbers_have_colours_that_can_be_told_apart() -> None:
    colours = number_colours(np.arange(-1, 60))[:, :3]
    assert colours[:2] == pytest.approx(np.array([GREY, GREY]))
    apart = np.linalg.norm(colours[2:, None] - colours[None, 2:], axis=-1) + np.eye(59)
    assert apart.min() > 0.03 and np.median(apart.min(1)) > 0.1
    near = [apart[n - 1, n + after - 1] for after in (13, 21, 34) for n in range(1, 60 - after)]
    assert min(near) > 0.1
