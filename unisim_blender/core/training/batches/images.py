"""Recorded images as training draws from them: all held, or a window of them that moves on as the steps go by.

Both are given views: which camera, which frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...world.drive import Camera
from .window import Window

ImageView = tuple[int, Camera, int]
"""A camera's number among those that are trained on, the camera, a frame."""
Decode = Callable[[Camera, int], NDArray[np.uint8]]
"""Gives an image (H, W, 3) of the camera's size."""

HELD_IMAGES, HELD_BYTES = 1024, 3 << 30
"""Largest number of images, and of bytes of them, that are all loaded at the start: enough for six cameras of eighty
frames at 1920 x 1080."""
WINDOW_BYTES = 1 << 30
"""Largest size of a window of images, bytes."""
AHEAD = 8
"""Images that are decoded before their step comes."""
STEPS_PER_IMAGE = 2
"""Steps from one image that a window takes in to the next."""


class ImageStore(Protocol):
    """Images by the number of their view."""

    def advance(self, step: int) -> None:
        """Let step ``step`` draw from what it may."""
        ...

    @property
    def drawable(self) -> NDArray[np.int64] | None:
        """The views (K,) that may be drawn from, increasing; None for all."""
        ...

    @property
    def first(self) -> Sequence[int]:
        """The views that the first step may draw from."""
        ...

    def image(self, view: int) -> NDArray[np.uint8]:
        """An image (H, W, 3) that may be drawn from."""
        ...

    def pixels(
        self, camera: int, view: NDArray[np.int64], y: NDArray[np.int64], x: NDArray[np.int64]
    ) -> NDArray[np.uint8]:
        """Pixels (..., 3) of one camera's views, rows and columns, which are broadcast."""
        ...


def bytes_of(views: Sequence[ImageView]) -> list[int]:
    """How large each view's image is."""
    return [3 * camera.model.width * camera.model.height for _, camera, _ in views]


def all_images_fit(views: Sequence[ImageView]) -> bool:
    """Whether so many images are held from the start."""
    return len(views) <= HELD_IMAGES and sum(bytes_of(views)) <= HELD_BYTES


class LoadedImages:
    """All images, decoded at once, camera by camera; ``views`` of a camera stand together."""

    drawable: NDArray[np.int64] | None = None

    def __init__(self, views: Sequence[ImageView], decode: Decode) -> None:
        self._first: dict[int, int] = {}
        self._images: dict[int, NDArray[np.uint8]] = {}
        self._number = [number for number, _, _ in views]
        for number in dict.fromkeys(self._number):
            own = [(camera, frame) for n, camera, frame in views if n == number]
            model = own[0][0].model
            images = np.zeros((len(own), model.height, model.width, 3), np.uint8)
            for image, (camera, frame) in zip(images, own, strict=True):
                image[:] = decode(camera, frame)
            self._first[number], self._images[number] = self._number.index(number), images

    def advance(self, step: int) -> None:
        """Nothing changes from step to step."""

    @property
    def first(self) -> Sequence[int]:
        """Every view."""
        return range(len(self._number))

    def image(self, view: int) -> NDArray[np.uint8]:
        """The view's image (H, W, 3)."""
        number = self._number[view]
        image: NDArray[np.uint8] = self._images[number][view - self._first[number]]
        return image

    def pixels(
        self, camera: int, view: NDArray[np.int64], y: NDArray[np.int64], x: NDArray[np.int64]
    ) -> NDArray[np.uint8]:
        """Pixels (..., 3) of one camera's views."""
        return np.asarray(self._images[camera][view - self._first[camera], y, x])


class ImageWindow:
    """A `Window` of images, which begins with ``first`` views and holds ``limit`` bytes at most."""

    def __init__(
        self, views: Sequence[ImageView], decode: Decode, first: Sequence[int], seed: int, limit: int = WINDOW_BYTES
    ) -> None:
        self._views, self._decode = views, decode
        self._stride = max(bytes_of(views)) // 3
        slots = min(len(views) + AHEAD, max(2 * AHEAD, limit // (3 * self._stride)), HELD_IMAGES + AHEAD)
        self._slab = np.zeros((slots, self._stride, 3), np.uint8)
        self._window = Window(len(views), slots, AHEAD, STEPS_PER_IMAGE, first, (seed, 0x1A6), self._load, "images")
        self._drawable: NDArray[np.int64] | None = None

    @property
    def drawable(self) -> NDArray[np.int64]:
        """See `ImageStore`; those of the first step before there was one."""
        if self._drawable is None:
            self.advance(0)
        assert self._drawable is not None
        return self._drawable

    @property
    def capacity(self) -> int:
        """How many images may be drawn from at most."""
        return self._window.capacity

    @property
    def nbytes(self) -> int:
        """Of the images' memory."""
        return self._slab.nbytes

    def advance(self, step: int) -> None:
        """Have the step's images, and those of the next steps under way."""
        self._drawable = self._window.advance(step)

    @property
    def first(self) -> Sequence[int]:
        """The views that the first step may draw from, in the order in which they are decoded."""
        return self._window.arrived(0)

    def image(self, view: int) -> NDArray[np.uint8]:
        """The view's image (H, W, 3); one of the first step's is waited for, and no other."""
        if self._drawable is None:
            self._window.wait(view)
        model = self._views[view][1].model
        image: NDArray[np.uint8] = self._slab[self._window.slot[view], : model.height * model.width]
        return image.reshape(model.height, model.width, 3)

    def pixels(
        self, camera: int, view: NDArray[np.int64], y: NDArray[np.int64], x: NDArray[np.int64]
    ) -> NDArray[np.uint8]:
        """Pixels (..., 3) of one camera's views."""
        width = next(c.model.width for number, c, _ in self._views if number == camera)
        return np.asarray(self._slab[self._window.slot[view], y * width + x])

    def _load(self, view: int, slot: int) -> None:
        _, camera, frame = self._views[view]
        image = self._decode(camera, frame)
        self._slab[slot, : camera.model.height * camera.model.width] = image.reshape(-1, 3)
