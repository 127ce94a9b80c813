"""The recording vehicle in its own images: found where it is, not where it is not, and left out."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from tiny_drive import TinyLog, tiny_drive

from unisim_blender.core.data.images import resize_image
from unisim_blender.core.data.own_vehicle import (
    _SMOOTH,
    LEAST_IMAGES,
    _filtered,
    _smaller_grey,
    find_outline,
    moved_frames,
    outlines_from_json,
    outlines_to_json,
    shows_scene,
)
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.training.batches.data import CameraData

ROOT = Path(os.environ.get("UNISIM_PANDASET", Path(__file__).parents[4] / "shared/data/pandaset/002"))
HEIGHT, WIDTH = 120, 200


def passing(count: int, bonnet: bool) -> tuple[list[NDArray[np.uint8]], NDArray[np.float64]]:
    """Images of what goes by, each another, with a bright bonnet below a curve or without; and the curve (W,)."""
    rng = np.random.default_rng(0)
    curve = 90 + 12 * ((np.arange(WIDTH) - WIDTH / 2) / WIDTH) ** 2 * 4
    below = np.arange(HEIGHT)[:, None] >= curve
    images = []
    for _ in range(count):
        world = ndimage.gaussian_filter(rng.uniform(0, 255, (HEIGHT, WIDTH)), 2) * 3 - 255
        shine = 200 + ndimage.gaussian_filter(rng.normal(0, 60, (HEIGHT, WIDTH)), 8)
        grey = np.where(below, shine, np.clip(world, 0, 160)) if bonnet else world
        images.append(np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, -1))
    return images, curve


def test_a_bonnet_is_found_along_its_outline() -> None:
    images, curve = passing(12, bonnet=True)
    outline = find_outline(images)
    assert outline is not None
    assert np.abs(outline - curve).max() <= 5
    assert (outline <= curve + 1).mean() > 0.95  # on the safe side


@pytest.mark.parametrize("size", [2, 3, 4, 9])
@pytest.mark.parametrize("axis", [0, 1])
def test_images_are_filtered_as_by_scipy(size: int, axis: int) -> None:
    values, weights = np.random.default_rng(0).normal(size=(23, 31)), np.random.default_rng(1).normal(size=size)
    ours = _filtered(values, weights, axis)
    assert np.allclose(ours, ndimage.correlate1d(values, weights, axis, mode="reflect"), rtol=0, atol=1e-12)
    assert np.allclose(
        _filtered(values, _SMOOTH, axis), ndimage.gaussian_filter1d(values, 1.0, axis), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize(("shape", "step"), [((23, 31), 4), ((24, 40), 2), ((17, 30), 3), ((9, 8), 1)])
def test_small_images_are_places_of_whole_filtered_ones(shape: tuple[int, int], step: int) -> None:
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3), np.uint8)
    even = np.full(step, 1 / step)
    every = _filtered(_filtered(image.mean(-1), even, 0), even, 1)
    assert np.allclose(_smaller_grey(image, step), every[::step, ::step], rtol=0, atol=1e-11)


def test_without_one_there_is_none() -> None:
    assert find_outline(passing(12, bonnet=False)[0]) is None


def test_few_images_tell_nothing() -> None:
    assert find_outline(passing(LEAST_IMAGES - 1, bonnet=True)[0]) is None


def test_images_between_which_the_vehicle_stands_are_passed_over() -> None:
    drive = tiny_drive(6)  # at 5 m/s, half a metre a frame
    assert moved_frames(drive, [0, 1, 2, 4]) == [0, 1, 2, 4]
    assert moved_frames(drive, [0, 0, 1, 1]) == [0, 1]


def test_outlines_survive_a_header_and_another_size() -> None:
    outline = np.arange(90, 90 + WIDTH) // 4
    found = outlines_from_json(outlines_to_json({"back": (outline, HEIGHT)}))
    assert np.array_equal(found["back"][0], outline) and found["back"][1] == HEIGHT
    v, u = np.mgrid[: HEIGHT * 2, : WIDTH * 2] + 0.5
    shown = shows_scene(outline, HEIGHT, u, v, (WIDTH * 2, HEIGHT * 2))
    assert np.abs(shown.sum(0)[::2] - 2 * outline).max() <= 1
    assert outlines_from_json(None) == {}


def test_training_draws_nothing_of_the_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    log = TinyLog()
    drive = log.drive
    name = next(iter(drive.cameras))
    model = drive.cameras[name].model
    outline = np.full(model.width, model.height - 6)
    outline[: model.width // 2] -= 4
    monkeypatch.setattr("unisim_blender.core.training.batches.data.find_outline", lambda images, shown: outline)
    data = CameraData(log, [name], [0, 1, 2], None, np.zeros(3))
    camera = data.cameras[name]
    rng = np.random.default_rng(0)
    for edge in (1, 5):
        x, y = data._corners(rng, 0, camera, edge, 4000)
        assert x.min() == 0 and x.max() == model.width - edge and y.min() == 0
        lowest = np.array([(outline[a : a + edge] - (b + edge - 1)).min() for a, b in zip(x, y, strict=True)])
        assert lowest.min() == 1  # up to the outline, and not beyond


@pytest.mark.skipif(not ROOT.is_dir(), reason=f"no real log at {ROOT}; set UNISIM_PANDASET to a PandaSet sequence")
@pytest.mark.parametrize(("camera", "there"), [("back_camera", True), ("front_camera", False)])
def test_a_real_drive(camera: str, there: bool) -> None:
    log = open_log(ROOT)
    model = log.drive.cameras[camera].model.resized(480)
    frames = moved_frames(log.drive, log.image_frames(camera))
    assert (find_outline([resize_image(log.image(camera, frame), model) for frame in frames]) is not None) == there
