"""Recorded beside rendered images: where an image lies in a view, its pixels, differences, views without one, views' options."""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import thing
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.bridge.objects.source import source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import LogError
from unisim_blender.core.scenario import scenario_to_json
from unisim_blender.core.world.drive import CameraModel
from unisim_blender.editing.images.comparison import (
    LINEAR,
    STRIPE_PX,
    Placement,
    difference,
    errors,
    hatched,
    lacks_recorded,
    placement,
    visible,
)
from unisim_blender.editing.images.recorded import MOST_SHOWN, RecordedImages, Shown, Wanted, resampled
from unisim_blender.editing.reading.requests import CameraRequest, camera_request, sized
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import SampledObject
from unisim_blender.editing.sampled.source import Source

FRONT = CameraModel(480, 270, 400.0, 402.0, 238.0, 136.0)


def noise(height: int, width: int) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3)).astype(np.uint8)


def test_an_image_fills_a_view_of_its_own_shape() -> None:
    for size in ((480, 270), (960, 540), (391, 220)):
        found = placement(FRONT, sized(FRONT, size, 1.0, True))
        assert found is not None and found.place == (0, 0, *size)
        np.testing.assert_allclose(found.box, (0, 0, 480, 270), atol=0.01)


def test_its_pixels_stay_where_the_intrinsics_have_them() -> None:
    """A view with another lens and another shape: a recorded pixel's ray goes through the view's pixel that shows it."""
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
    shown = resampled(image, Placement((160, 90), (0, 0, 480, 270), (0, 0, 160, 90)))
    means = image.reshape(90, 3, 160, 3, 3).mean((1, 3))
    assert np.abs(shown.srgb[::-1] - means).max() <= 1


def test_a_larger_image_is_interpolated_without_a_shift() -> None:
    ramp = np.broadcast_to(np.arange(0, 240, 2, dtype=np.uint8)[None, :, None], (60, 120, 3))
    shown = resampled(np.ascontiguousarray(ramp), Placement((360, 180), (0, 0, 120, 60), (0, 0, 360, 180)))
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
    wanted = image.copy()
    for y, x in np.argwhere(unsupported):
        if (y + x) // STRIPE_PX % 2 == 0:
            wanted[y, x] = 0.6 * image[y, x] + 0.4 * np.array([1.0, 0.02, 0.02, 1.0])
    np.testing.assert_allclose(hatched(image, unsupported), wanted, atol=1e-6)


def request(street: Any, view: Any, frame: float = 9.0) -> tuple[SampledObject, CameraRequest, Source]:
    source = source_of(street)
    sampled = sample_all(street, Clock.of(source.drive).around(frame))
    looking = next(one for one in sampled.things if one.name == view.name)
    return looking, camera_request(sampled, looking, source, frame, (480, 270)), source


def lack(street: Any, view: Any, frame: float = 9.0) -> str:
    looking, asked, source = request(street, view, frame)
    return lacks_recorded(looking, scenario_to_json(asked.scenario), source.drive, source.log, frame)


@pytest.fixture
def front(street: Any) -> Any:
    if source_of(street).log is None:
        pytest.skip("the sample's log is not at hand: make demo")
    return thing(street, "CAMERA", "front_camera")


def test_a_recorded_camera_has_its_image(street: Any, front: Any) -> None:
    assert lack(street, front) == ""
    looking, asked, source = request(street, front)
    model = asked.model
    found = placement(source.drive.cameras["front_camera"].model, model)
    assert found is not None and found.place == (0, 0, 480, 270)


def test_what_has_none_says_why(street: Any, front: Any) -> None:
    assert "recorded image of frame 9.5" in lack(street, front, 9.5)
    assert "recorded image of frame 40" in lack(street, front, 40.0)
    looking, asked, source = request(street, front)
    assert "log is not at hand" in lacks_recorded(looking, scenario_to_json(asked.scenario), source.drive, None, 9)
    nobody = SampledObject("viewport", "NONE", "", "", "", "", "", 0, looking.poses, looking.there, looking.camera)
    assert "look through a recorded camera" in lacks_recorded(
        nobody, scenario_to_json(asked.scenario), source.drive, source.log, 9
    )
    copy = front.copy()
    street.collection.objects.link(copy)
    assert "added camera" in lack(street, copy)


def test_a_camera_that_was_moved_has_none(street: Any, front: Any) -> None:
    front.location.z += 0.01
    assert "not where it recorded" in lack(street, front)
    front.location.z -= 0.01
    assert lack(street, front) == ""
    thing(street, "EGO", "ego").delta_location.y += 0.5
    assert "not where it recorded" in lack(street, front)


def test_another_lens_still_shows_the_recorded_image(street: Any, front: Any) -> None:
    front.data.lens *= 2
    assert lack(street, front) == ""


def wait(images: RecordedImages, wanted: Wanted) -> Shown:
    until = time.monotonic() + 20
    while time.monotonic() < until:
        found = images.get(wanted)
        if found is not None:
            return found
        time.sleep(0.01)
    raise AssertionError("no image comes")


@pytest.fixture
def log(street_log: Path) -> Log:
    from unisim_blender.core.data import open_log

    return open_log(street_log)


def wanted(log: Log, frame: int, width: int = 96) -> Wanted:
    model = log.drive.cameras["front_camera"].model
    found = placement(model, model.resized(width))
    assert found is not None
    return Wanted(log, "front_camera", frame, found)


def test_images_come_from_a_thread_and_are_kept(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    images, decoded, decode = RecordedImages(), [], log.image

    def counted(camera: str, frame: int) -> NDArray[np.uint8]:
        decoded.append(frame)
        time.sleep(0.2)
        return decode(camera, frame)

    monkeypatch.setattr(log, "image", counted)
    try:
        begun = time.monotonic()
        assert images.get(wanted(log, 0)) is None and images.get(wanted(log, 0)) is None
        images.fetch(wanted(log, 1))
        assert time.monotonic() - begun < 0.1, "it waits for the file"
        first = wait(images, wanted(log, 0))
        with Image.open(log.image_path("front_camera", 0) or "") as file:
            np.testing.assert_array_equal(first.srgb, np.asarray(file.convert("RGB"))[::-1])
        assert images.get(wanted(log, 0)) is first
        wait(images, wanted(log, 1))
        wait(images, wanted(log, 0, 48))
        assert decoded == [0, 1], "an image is decoded once for all sizes"
        for width in range(50, 50 + MOST_SHOWN):
            wait(images, wanted(log, 1, width))
        assert images.get(wanted(log, 0)) is None and len(images._shown) <= MOST_SHOWN
    finally:
        images.close()


def test_a_broken_image_is_a_sentence(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(camera: str, frame: int) -> NDArray[np.uint8]:
        raise LogError("/there/01.jpg: cannot be decoded (truncated)")

    images = RecordedImages()
    monkeypatch.setattr(log, "image", broken)
    try:
        assert wait(images, wanted(log, 0)).problem == "/there/01.jpg: cannot be decoded (truncated)"
    finally:
        images.close()


def test_each_view_has_options_of_its_own(scene: Any) -> None:
    from unisim_blender.view_options import options_of

    spaces = [area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"]
    assert len(spaces) > 1
    options_of(spaces[0]).mode = "SPLIT"
    assert options_of(spaces[0]).mode == "SPLIT" and options_of(spaces[1]).mode == "RENDERED"
    assert options_of(spaces[1]).clip and not options_of(spaces[1]).unsupported
    options_of(spaces[0]).mode = "RENDERED"


def test_the_panel_sets_what_views_have(scene: Any) -> None:
    from unisim_blender.view_options import MODES, options_of

    holder = bpy.context.window_manager.unisim_view
    here = options_of(bpy.context.space_data)
    before = asdict(here)
    for name, *_ in MODES:
        holder.mode = name
        assert here.mode == name == holder.mode
    holder.split, holder.gain, holder.unsupported, holder.clip = 0.25, 8.0, True, False
    assert (here.split, here.gain, here.unsupported, here.clip) == (0.25, 8.0, True, False)
    for name, value in before.items():
        setattr(here, name, value)
