"""Images that are read as training needs them: which, when, and how many.

Training and surfels use the images and sweeps between frames that belong to the frames that they use, and no others.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from small_log import write_small_log
from small_training import SMALL
from tiny_drive import TinyLog, log_with_captures_between, tiny_drive

from unisim_blender.core.data.own_vehicle import given_outline, joined
from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.render.tracers.surfels import build
from unisim_blender.core.training import setup as training_setup
from unisim_blender.core.training.batches import images as module
from unisim_blender.core.training.batches.data import CameraData, LidarData, lidar_captures
from unisim_blender.core.training.batches.images import (
    AHEAD,
    EVEN,
    MOST_OFTEN,
    STEPS_PER_IMAGE,
    ImageView,
    ImageWindow,
    LoadedImages,
    PixelChoice,
)
from unisim_blender.core.training.trainer import Trainer
from unisim_blender.core.world.drive import Camera

FRAMES = 60
CAMERA = tiny_drive(6).cameras["front"]
VIEWS: list[ImageView] = [(0, CAMERA, frame) for frame in range(FRAMES)]
IMAGE_BYTES = 3 * CAMERA.model.width * CAMERA.model.height
LIMIT = 30 * IMAGE_BYTES


def picture(camera: Camera, frame: int) -> NDArray[np.uint8]:
    return np.random.default_rng(frame).integers(0, 255, (camera.model.height, camera.model.width, 3), np.uint8)


def test_a_window_holds_what_it_says_and_no_more_than_its_limit() -> None:
    window = ImageWindow(VIEWS, picture, [5, 50], 0, LIMIT)
    seen: set[int] = set()
    assert window.nbytes <= LIMIT and window.capacity == 30 - AHEAD
    for step in range(0, 4 * FRAMES):
        window.advance(step)
        assert window.drawable is not None
        assert len(window.drawable) == min(2 + step // STEPS_PER_IMAGE, window.capacity)
        seen |= set(window.drawable.tolist())
        for view in window.drawable[::7].tolist():
            np.testing.assert_array_equal(window.image(view), picture(CAMERA, view))
    assert seen == set(range(FRAMES)), "every image has its turn"
    assert window.drawable is not None
    view, y, x = window.drawable[[0, 3, 3]], np.array([0, 17, 4]), np.array([31, 0, 9])
    held = LoadedImages(VIEWS, picture)
    np.testing.assert_array_equal(window.pixels(0, view, y, x), held.pixels(0, view, y, x))


def test_what_may_be_drawn_follows_from_the_step_alone() -> None:
    """However slowly images are decoded, and from whatever step one goes on."""

    def slow(camera: Camera, frame: int) -> NDArray[np.uint8]:
        time.sleep(0.002 * (frame % 3))
        return picture(camera, frame)

    quick, late = ImageWindow(VIEWS, picture, [5, 50], 3, LIMIT), ImageWindow(VIEWS, slow, [5, 50], 3, LIMIT)
    other = ImageWindow(VIEWS, picture, [5, 50], 4, LIMIT)
    apart = 0
    for step in (0, 1, 7, 40, 41, 130, 131):
        for window in (quick, late, other):
            window.advance(step)
        assert quick.drawable is not None and late.drawable is not None and other.drawable is not None
        np.testing.assert_array_equal(quick.drawable, late.drawable)
        for view in quick.drawable.tolist():
            np.testing.assert_array_equal(quick.image(view), late.image(view))
        apart += len(quick.drawable) != len(other.drawable) or bool((quick.drawable != other.drawable).any())
    assert apart, "another seed has another order"
    resumed = ImageWindow(VIEWS, picture, [5, 50], 3, LIMIT)
    resumed.advance(131)
    assert resumed.drawable is not None and quick.drawable is not None
    np.testing.assert_array_equal(resumed.drawable, quick.drawable)
    np.testing.assert_array_equal(resumed.image(int(resumed.drawable[0])), quick.image(int(quick.drawable[0])))


def test_a_window_with_room_for_all_fills_up_and_stays() -> None:
    window = ImageWindow(VIEWS, picture, [1], 0, 10 * LIMIT)
    window.advance(10 * FRAMES)
    assert window.drawable is not None and window.drawable.tolist() == list(range(FRAMES))


def test_few_are_decoded_before_the_first_step_and_by_another_thread() -> None:
    threads: dict[int, str] = {}
    asked = threading.Event()

    def decode(camera: Camera, frame: int) -> NDArray[np.uint8]:
        assert frame != 5 or asked.wait(20)
        threads[frame] = threading.current_thread().name
        if frame == 50:
            asked.set()
        return picture(camera, frame)

    window = ImageWindow(VIEWS, decode, [5, 50], 0, LIMIT)
    assert window.drawable.tolist() == [5, 50]
    assert threads[5].startswith("images"), "without being asked for"
    assert threads[50] == threading.current_thread().name, "who waits reads what is not begun"
    assert set(threads) == {5, 50}, "what is ahead comes after the first step"
    window.advance(1)
    window.advance(2 * STEPS_PER_IMAGE * AHEAD)
    assert len(threads) > 2 + AHEAD


def test_an_image_that_cannot_be_read_is_the_steps_error() -> None:
    def decode(camera: Camera, frame: int) -> NDArray[np.uint8]:
        if frame == 50:
            raise LogError("50.jpg: cannot be decoded")
        return picture(camera, frame)

    window = ImageWindow(VIEWS, decode, [5, 50], 0, LIMIT)
    np.testing.assert_array_equal(window.image(5), picture(CAMERA, 5))
    for wait in (lambda: window.image(50), lambda: window.drawable, lambda: window.advance(1)):
        with pytest.raises(LogError, match="50.jpg"):
            wait()


def test_only_the_image_that_is_asked_for_is_waited_for() -> None:
    """What is looked for in one camera's images runs while the next camera's are decoded."""
    go_on = threading.Event()

    def decode(camera: Camera, frame: int) -> NDArray[np.uint8]:
        assert frame != 50 or go_on.wait(20)
        return picture(camera, frame)

    window = ImageWindow(VIEWS, decode, [5, 50], 0, LIMIT)
    assert list(window.first) == [5, 50]
    np.testing.assert_array_equal(window.image(5), picture(CAMERA, 5))
    assert not go_on.is_set(), "the second image is not there yet"
    go_on.set()
    np.testing.assert_array_equal(window.image(50), picture(CAMERA, 50))


def test_pixels_are_drawn_from_the_window_alone() -> None:
    choice = PixelChoice([np.full(32, 18) for _ in range(FRAMES)])
    some = np.array([3, 4, 40])
    draw = choice.draw(np.random.default_rng(0), 3000, some)
    assert set(np.unique(draw.view)) == set(some)
    assert float(draw.weight.mean()) == pytest.approx(1, abs=0.05)
    every, all_of_them = (choice.draw(np.random.default_rng(1), 200, views) for views in (None, np.arange(FRAMES)))
    np.testing.assert_array_equal(every.view, all_of_them.view)


def test_small_actors_are_drawn_more_often() -> None:
    rooms = [np.full(320, 180)] * 2
    cone, car, far = [40.0, 40, 44, 48], [160.0, 40, 304, 136], [8.0, 8, 9, 9]
    choice = PixelChoice(rooms, [np.array([cone, car, far]), np.zeros((0, 4))])
    draw = choice.draw(np.random.default_rng(0), 200_000)

    def share(rectangle: list[float], view: int = 0) -> float:
        left, top, right, bottom = rectangle
        inside = (draw.view == view) & (draw.x >= left) & (draw.x < right) & (draw.y >= top) & (draw.y < bottom)
        return float(inside.sum()) / ((right - left) * (bottom - top))

    even = share([0, 100, 100, 180], 1)
    assert share(cone) > 4 * even and share(car) < 1.2 * even and even < share(far) < (MOST_OFTEN + 1.3) * even
    assert float(draw.weight.mean()) == pytest.approx(1, abs=0.02) and draw.weight.max() <= 1 / EVEN
    fresh = PixelChoice(rooms)
    np.testing.assert_allclose(fresh.even, fresh.width * fresh.height / (2 * 320 * 180))


def test_training_data_of_many_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same patches whether images come as they are needed or a window has room for all of them."""
    log = TinyLog()
    monkeypatch.setattr(module, "MEMORY_IMAGES", 4)
    data = CameraData(log, ["front"], list(log.drive.frames), None, np.zeros(3), 0)
    assert isinstance(data.images, ImageWindow)
    data.advance(0)
    batch = data.patches(np.random.default_rng(0), 6, 4, 1)
    frames = np.round(batch.target.mean((1, 2, 3)).numpy() * 255)
    times = batch.rays.time_s.view(6, 16)[:, 0].numpy()
    for value, time_s in zip(frames, times, strict=True):
        frame = min(log.drive.frames, key=lambda f: abs(log.drive.time_s[f] - time_s))
        assert value == log.image("front", frame)[0, 0, 0], "a patch's colours are of its rays' image"


def test_images_are_read_while_the_model_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_small_log(tmp_path / "log")
    log, begun, made = open_log(tmp_path / "log"), threading.Event(), threading.Event()
    image, scene = log.image, SceneModel

    def read(camera: str, frame: int) -> NDArray[np.uint8]:
        begun.set()
        assert made.wait(20), "the model is not made before an image is there"
        return image(camera, frame)

    def make(*arguments: Any) -> SceneModel:
        assert begun.wait(20), "no image is read before the model is made"
        made.set()
        return scene(*arguments)

    monkeypatch.setattr(log, "image", read)
    monkeypatch.setattr(training_setup, "SceneModel", make)
    monkeypatch.setattr(module, "MEMORY_IMAGES", 1)
    trainer = Trainer(log, SMALL)
    assert isinstance(trainer.cameras.images, ImageWindow)
    assert np.isfinite(trainer.step()["loss"])


# Masks that a log gives


class Masked(TinyLog):
    mask: Any = None

    def own_vehicle_mask(self, camera: str) -> Any:
        return self.mask


def test_a_logs_mask_is_left_out_beside_our_own_finding() -> None:
    log, model = Masked(), CAMERA.model
    assert given_outline(log, "front", model) is None and given_outline(TinyLog(), "front", model) is None
    log.mask = np.zeros((18, 32), bool)
    log.mask[15:, 4:] = True
    log.mask[13, 20] = True
    outline = given_outline(log, "front", model)
    assert outline is not None and outline.tolist() == [18] * 4 + [15] * 16 + [13] + [15] * 11
    half = given_outline(log, "front", model.resized(16))
    assert half is not None and half.tolist() == [9, 9] + [7] * 8 + [6] + [7] * 5
    both = joined(np.full(32, 14), outline)
    assert both is not None and both.tolist() == [14] * 20 + [13] + [14] * 11
    data = CameraData(log, ["front"], [0, 1, 2], None, np.zeros(3))
    assert data.outlines["front"][0].tolist() == outline.tolist()


def test_masks_that_cannot_be_used() -> None:
    log = Masked()
    log.mask = np.zeros((17, 32), bool)
    with pytest.raises(LogError, match=r"tiny: the mask of front is bool \(17, 32\), not bool \(18, 32\)"):
        given_outline(log, "front", CAMERA.model)
    log.mask = np.zeros((18, 32), bool)
    log.mask[2, 3:5] = True
    with pytest.warns(UserWarning, match="2 pixels of the upper half in the mask of front"):
        assert given_outline(log, "front", CAMERA.model) is None


@pytest.fixture
def log() -> TinyLog:
    return log_with_captures_between()


def test_images(log: TinyLog) -> None:
    for frames, taken in (([1, 3], [1, 3, 6]), ([0, 2, 4], [0, 2, 7, 4])):
        data = CameraData(log, ["front"], frames, None, np.zeros(3))
        assert [frame for _, _, frame in data.views] == taken
        assert build._chosen_images(log, "front", set(frames)) == taken


def test_sweeps(log: TinyLog) -> None:
    for frames, taken in (((1, 3), [1, 6, 3]), ((0, 2, 4), [0, 2, 4])):
        assert [frame for _, frame in lidar_captures(log, ("top",), frames)] == taken
        assert build._captures(log, "top", set(frames)) == taken
        times = LidarData(log, ("top",), frames, np.zeros(3)).time_s
        assert ((times > 0.2) & (times < 0.26)).any() == (6 in taken)
