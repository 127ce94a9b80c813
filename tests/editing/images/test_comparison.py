"""Recorded beside rendered images: where an image lies in a view, its pixels, differences, hatching,
loading in a thread."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import LogError
from unisim_blender.core.world.drive import CameraModel
from unisim_blender.editing.images.comparison import (
    LINEAR,
    MOST_SHOWN,
    STRIPE_PX,
    ImagePlacement,
    RecordedImageRequest,
    RecordedImages,
    ShownImage,
    difference,
    errors,
    hatched,
    placement,
    resampled,
    tint,
    tinted,
    visible,
)
from unisim_blender.editing.reading.requests import sized

FRONT = CameraModel(480, 270, 400.0, 402.0, 238.0, 136.0)


def noise(height: int, width: int) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3)).astype(np.uint8)


def test_an_image_fills_a_view_of_its_own_shape() -> None:
    for size in ((480, 270), (960, 540), (391, 220)):
        found = placement(FRONT, sized(FRONT, size, 1.0, True))
        assert found is not None and found.place == (0, 0, *size)
        np.testing.assert_allclose(found.box, (0, 0, 480, 270), atol=0.01)


def test_its_pixels_stay_where_the_intrinsics_have_them() -> None:
    """A view with another lens and another shape: a recorded pixel's ray goes through the view's
    pixel that shows it."""
    other = CameraModel(600, 200, 900.0, 880.0, 250.0, 120.0)
    found = placement(FRONT, other)
    assert found is not None and found.place == (0, 0, 600, 200)
    for column, across in ((0, found.box[0]), (600, found.box[2])):
        assert (column - other.cx) / other.fx == pytest.approx((across - FRONT.cx) / FRONT.fx)
    for row, down in ((0, found.box[1]), (200, found.box[3])):
        assert (row - other.cy) / other.fy == pytest.approx((down - FRONT.cy) / FRONT.fy)


def test_a_wider_view_is_covered_in_part() -> None:
    wide = CameraModel(480, 270, 200.0, 201.0, 240.0, 135.0)
    found = placement(FRONT, wide)
    assert found is not None
    left, top, right, bottom = found.place
    assert 110 < left < 130 and 350 < right < 370 and 60 < top < 75 and 195 < bottom < 210
    shown = resampled(np.full((270, 480, 3), 200, np.uint8), found)
    assert (shown.srgb[shown.covered] == 200).all() and (shown.srgb[~shown.covered] == 0).all()
    assert shown.covered.sum() == (right - left) * (bottom - top)
    assert (shown.linear[~shown.covered] == 0).all() and (shown.linear[shown.covered][:, 3] == 1).all()
    assert shown.covered[270 - bottom : 270 - top, left:right].all(), "its lowest row is not first"
    assert placement(FRONT, replace(wide, cx=3000.0)) is None


def test_pixels_of_the_same_size_are_the_same() -> None:
    image = noise(270, 480)
    found = placement(FRONT, FRONT)
    assert found is not None
    shown = resampled(image, found)
    np.testing.assert_array_equal(shown.srgb, image[::-1])
    np.testing.assert_array_equal(shown.linear[..., :3], LINEAR[image[::-1]])


def test_a_smaller_image_has_the_mean_of_what_it_covers() -> None:
    image = noise(270, 480)
    shown = resampled(image, ImagePlacement((160, 90), (0, 0, 480, 270), (0, 0, 160, 90)))
    means = image.reshape(90, 3, 160, 3, 3).mean((1, 3))
    assert np.abs(shown.srgb[::-1] - means).max() <= 1


def test_a_larger_image_is_interpolated_without_a_shift() -> None:
    ramp = np.broadcast_to(np.arange(0, 240, 2, dtype=np.uint8)[None, :, None], (60, 120, 3))
    shown = resampled(np.ascontiguousarray(ramp), ImagePlacement((360, 180), (0, 0, 120, 60), (0, 0, 360, 180)))
    expected = 2 * ((np.arange(360) + 0.5) / 3 - 0.5)
    assert np.abs(shown.srgb[90, 3:-3, 0] - expected[3:-3]).max() <= 1


def test_difference_and_errors() -> None:
    a, covered = np.full((4, 5, 3), 100, np.uint8), np.ones((4, 5), bool)
    b = a.copy()
    b[0, 0] = (110, 95, 100)
    b[1, 1] = 200
    covered[3] = False
    found = difference(a, covered, b, 4.0)
    np.testing.assert_allclose(found[0, 0], [*LINEAR[[40, 20, 0]], 1.0])
    np.testing.assert_allclose(found[1, 1], [1, 1, 1, 1])
    assert (found[3] == 0).all() and (found[2, :, :3] == 0).all()
    mean, psnr = errors(a, covered, b) or (0.0, 0.0)
    assert mean == pytest.approx((10 + 5 + 300) / 45)
    assert psnr == pytest.approx(10 * np.log10(255**2 / ((100 + 25 + 30000) / 45)))
    assert errors(a, covered, a) == (0.0, 99.0) and errors(a, np.zeros((4, 5), bool), b) is None


def test_what_a_region_shows_of_an_image() -> None:
    assert visible((10, 20, 100, 50), (400, 300)) == (slice(0, 50), slice(0, 100))
    assert visible((-30, -20, 100, 50), (60, 10)) == (slice(20, 30), slice(30, 90))
    assert visible((500, 0, 100, 50), (400, 300))[1] == slice(0, 0)


def test_doubted_pixels_are_orange_and_wrong_ones_red() -> None:
    confidence = np.array([[1.0, 0.8, 0.5, 0.2, 0.0]], np.float32)
    clear, threshold, orange, red, wrong = tint(confidence)[0]
    assert not clear.any() and not threshold.any()
    np.testing.assert_allclose(orange, 0.3 * np.array([1.0, 0.6, 0.0, 1.0]), atol=1e-6)
    np.testing.assert_allclose(red, 0.6 * np.array([1.0, 0.02, 0.02, 1.0]), atol=1e-6)
    np.testing.assert_array_equal(wrong, red)
    image = np.full((1, 5, 4), 0.5, np.float32)
    image[..., 3] = 1
    over = tinted(image, confidence)
    np.testing.assert_array_equal(over[0, 0], image[0, 0])
    np.testing.assert_allclose(over[0, 3], [0.8, 0.212, 0.212, 1.0], atol=1e-6)


def test_hatching_lies_over_unsupported_pixels_alone() -> None:
    image = np.full((60, 80, 4), 0.5, np.float32)
    image[..., 3] = 1.0
    unsupported = np.zeros((60, 80), bool)
    unsupported[20:50, 10:70] = True
    found = hatched(image, unsupported)
    changed = (found != image).any(-1)
    assert not changed[~unsupported].any() and 0.4 < changed[unsupported].mean() < 0.6
    assert (found[changed][:, 0] > 0.6).all() and (found[changed][:, 1] < 0.35).all()
    assert (image == np.array([0.5, 0.5, 0.5, 1.0])).all()
    row = changed[30, 10:70]
    assert np.diff(np.flatnonzero(np.diff(row.astype(int)))).max() == STRIPE_PX, "stripes, diagonal"


def test_hatching_is_what_each_pixel_says() -> None:
    draw = np.random.default_rng(4)
    image, unsupported = draw.random((23, 31, 4), np.float32), draw.random((23, 31)) < 0.5
    request = image.copy()
    for y, x in np.argwhere(unsupported):
        if (y + x) // STRIPE_PX % 2 == 0:
            request[y, x] = 0.6 * image[y, x] + 0.4 * np.array([1.0, 0.02, 0.02, 1.0])
    np.testing.assert_allclose(hatched(image, unsupported), request, atol=1e-6)


def wait(images: RecordedImages, request: RecordedImageRequest) -> ShownImage:
    until = time.monotonic() + 20
    while time.monotonic() < until:
        found = images.get(request)
        if found is not None:
            return found
        time.sleep(0.01)
    raise AssertionError("no image comes")


@pytest.fixture
def log(street_log: Path) -> Log:
    from unisim_blender.core.formats.readers import open_log

    return open_log(street_log)


def request(log: Log, frame: int, width: int = 96) -> RecordedImageRequest:
    model = log.drive.cameras["front_camera"].model
    found = placement(model, model.resized(width))
    assert found is not None
    return RecordedImageRequest(log, "front_camera", frame, found)


def test_images_come_from_a_thread_and_are_kept(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    images, decoded, decode = RecordedImages(), [], log.image
    asked, late = Event(), []

    def counted(camera: str, frame: int) -> NDArray[np.uint8]:
        decoded.append(frame)
        if not asked.wait(20):
            late.append(frame)
        return decode(camera, frame)

    monkeypatch.setattr(log, "image", counted)
    try:
        assert images.get(request(log, 0)) is None and images.get(request(log, 0)) is None
        images.fetch(request(log, 1))
        assert not late, "it waits for the file"
        asked.set()
        first = wait(images, request(log, 0))
        with Image.open(log.image_path("front_camera", 0) or "") as file:
            np.testing.assert_array_equal(first.srgb, np.asarray(file.convert("RGB"))[::-1])
        assert images.get(request(log, 0)) is first
        wait(images, request(log, 1))
        wait(images, request(log, 0, 48))
        assert decoded == [0, 1], "an image is decoded once for all sizes"
        for width in range(50, 50 + MOST_SHOWN):
            wait(images, request(log, 1, width))
        assert images.get(request(log, 0)) is None and len(images._shown) <= MOST_SHOWN
    finally:
        images.close()


def test_a_broken_image_is_a_sentence(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(camera: str, frame: int) -> NDArray[np.uint8]:
        raise LogError("/there/01.jpg: cannot be decoded (truncated)")

    images = RecordedImages()
    monkeypatch.setattr(log, "image", broken)
    try:
        assert wait(images, request(log, 0)).problem == "/there/01.jpg: cannot be decoded (truncated)"
    finally:
        images.close()
