"""The learned fixer: its network beside the one that is trained, and what it leaves alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from benchmarks.learned_fixer import FillNetwork, read_weights, write_weights
from unisim_blender.core.render import learned_fixer
from unisim_blender.core.render.fixers import ImageToFix, ReferenceImage
from unisim_blender.core.render.learned_fixer import MARGIN, WEIGHTS, LearnedFixer, added, network_input, part_of
from unisim_blender.core.world.drive import CameraModel


@pytest.fixture
def view() -> ImageToFix:
    random = np.random.default_rng(0)
    height, width = 101, 173

    def some(*more: int) -> NDArray[np.float32]:
        return random.random((height, width, *more), np.float32)

    weight = np.zeros((height, width), np.float32)
    weight[40:50, 30:44] = 1
    depth = np.where(some() < 0.2, np.inf, 30 * some()).astype(np.float32)
    model, pose = CameraModel(width, height, 100.0, 100.0, 80.0, 50.0), np.eye(4)
    references = tuple(ReferenceImage(some(3), model, pose, some(3), some() < 0.5) for _ in range(2))
    instance = random.integers(0, 3, (height, width)).astype(np.int32)
    return ImageToFix(some(3), depth, instance, some(), weight, some(), references, model, pose)


def test_the_network_is_the_one_that_was_trained(
    tmp_path: Path, view: ImageToFix, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(1)
    write_weights(FillNetwork(), tmp_path / "random.npz")
    given = network_input(view)
    for path in (WEIGHTS, tmp_path / "random.npz"):
        monkeypatch.setattr(learned_fixer, "WEIGHTS", path)
        learned_fixer.weights.cache_clear()
        with torch.no_grad():
            expected = read_weights(path)(torch.from_numpy(given).permute(2, 0, 1)[None])[0].permute(1, 2, 0).numpy()
        assert np.abs(expected).max() > 1e-3
        np.testing.assert_allclose(added(given), expected, atol=2e-5 * np.abs(expected).max(), rtol=1e-4)
    learned_fixer.weights.cache_clear()


def test_only_what_is_near_the_pixels_to_fix_is_computed(view: ImageToFix) -> None:
    image, given = LearnedFixer()(view), network_input(view)
    changed = np.argwhere((image != view.image).any(-1))
    assert changed.max(0)[1] < 44 + MARGIN and len(changed) > 1000
    expected = view.image + part_of(given) * added(given)
    some = view.weight > 0
    np.testing.assert_allclose(image[some], expected[some], atol=0.01)


def test_what_has_the_skys_colour_stays(view: ImageToFix) -> None:
    image, depth = view.image.copy(), np.full(view.depth_m.shape, 20.0, np.float32)
    some = view.weight > 0
    image[:30], depth[:30], image[40:44, 30:44] = [0.6, 0.7, 0.9], np.inf, [0.62, 0.66, 0.85]
    sheet = replace(view, image=image, depth_m=depth)
    changed = (LearnedFixer()(sheet) != image).any(-1)
    assert not changed[40:44, 30:44].any() and changed[some].mean() > 0.3
    without_sky = replace(sheet, depth_m=np.full_like(depth, 20.0))
    assert (LearnedFixer()(without_sky) != image).any(-1)[some].all()


def test_views_with_fewer_recorded_images(view: ImageToFix) -> None:
    for count in (0, 1):
        alone = replace(view, references=view.references[:count])
        given = network_input(alone)
        assert given.shape[-1] == 16 and np.isfinite(given).all()
        assert np.isfinite(LearnedFixer()(alone)).all()
    assert not network_input(replace(view, references=()))[..., 8:].any()
