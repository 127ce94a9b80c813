"""Recorded images as training draws from them: all in memory, or a window of them that moves on as the steps go by; and
the choice of pixels: more of those whose error was large of late.

Both are given views: which camera, which frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...geometry import BoolArray, FloatArray
from ...world.drive import Camera
from .window import Window

EVEN = 0.4
"""Share of the draws that falls evenly, so that no pixel is forgotten, and no weight is large."""
ERROR_DECAY = 0.8
"""How much of a block's error is still what it was after one more look."""
FIRST_ERROR = 0.05
"""Error of a block that was never drawn, of 1."""
SMALL_ACTOR, MOST_OFTEN = 0.05, 6.0
"""Edge, as a share of the image's width, of the square that an actor counts as, at least, and how much more its pixels count then
at most."""
BLOCK, MOST_BLOCKS = 8, 250_000
"""Edge in pixels at least; and how many blocks there are at most."""
PixelBuffer = NDArray[Any]
"""Which pixels of an image may be drawn: how many rows, from above, of each column (W,) int; or a mask (H, W) bool."""


@dataclass(frozen=True)
class PixelDraw:
    """Pixels (N,) drawn from images, those of an image together: the image's number, column, row, the block that each
    lies in, and the weight that makes up for its chance, 1 on average."""

    view: NDArray[np.int64]
    x: NDArray[np.int64]
    y: NDArray[np.int64]
    block: NDArray[np.int64]
    weight: FloatArray


class PixelChoice:
    """Draws pixels from images in proportion to how large the error was in their block of late.

    Chances in proportion to a term's size leave a sum the least variance (importance sampling; for gradients, which
    grow as the error does: Katharopoulos and Fleuret, "Not All Samples Are Created Equal", 2018). Weighted by
    `PixelDraw.weight`, means are those of draws by `even`. ``rooms``: for each image which of its pixels may be drawn.
    ``actors``: for each image the rectangles (A, 4) of actors, left, top, right, bottom. A cone has a thousandth of an image's
    pixels, and even draws would teach little of it: means are biased, on purpose, so that its pixels count more.
    """

    def __init__(self, rooms: Sequence[PixelBuffer], actors: Sequence[FloatArray] = ()) -> None:
        pixels = sum(int(room.sum()) for room in rooms)
        edge = max(BLOCK, int(np.ceil(np.sqrt(pixels / MOST_BLOCKS))))
        # views of a camera share their room
        of_room = {id(room): _mask_blocks(room, edge) if room.ndim == 2 else _blocks(room, edge) for room in rooms}
        parts = [np.insert(of_room[id(room)], 0, view, 1) for view, room in enumerate(rooms)]
        self.view, self.x, self.y, self.width, self.height = np.concatenate(parts).T
        area = (self.width * self.height).astype(np.float64)
        begins = np.searchsorted(self.view, np.arange(len(rooms) + 1))
        for room, rectangles, begin, end in zip(rooms, actors, begins, begins[1:], strict=False):
            own = slice(begin, end)
            x, y, width, height = (values[own, None] for values in (self.x, self.y, self.width, self.height))
            left, top, right, bottom = rectangles.T
            across = np.minimum(x + width, right) - np.maximum(x, left)
            down = np.minimum(y + height, bottom) - np.maximum(y, top)
            size = np.maximum((right - left) * (bottom - top), 1.0)
            often = (across.clip(0) * down.clip(0) * (SMALL_ACTOR * room.shape[-1]) ** 2 / size).sum(1)
            area[own] += np.minimum(often, MOST_OFTEN * area[own])
        self.even = area / area.sum()
        """Chances of blocks in proportion to their pixels, those of small actors counted more than once."""
        self._on_device: Tensor | None = None
        self._error = np.full(len(area), FIRST_ERROR)

    def draw(self, rng: np.random.Generator, count: int, views: NDArray[np.int64] | None = None) -> PixelDraw:
        """``count`` pixels, of some views (K,) alone where they are given."""
        even = self.even
        if views is not None:
            allowed = np.zeros(int(self.view.max()) + 1 if len(self.view) else 0, bool)
            allowed[views[views < len(allowed)]] = True
            even = even * allowed[self.view]
            even = even / even.sum()
        large = even * self._error
        chance = EVEN * even + (1 - EVEN) / large.sum() * large
        ends = np.cumsum(chance)
        block = np.searchsorted(ends, np.sort(rng.random(count)) * ends[-1], side="right")
        x = self.x[block] + rng.integers(self.width[block])
        y = self.y[block] + rng.integers(self.height[block])
        return PixelDraw(self.view[block], x, y, block, even[block] / chance[block])

    def note(self, block: NDArray[np.int64], square: FloatArray) -> None:
        """Record the squared errors (N,) of pixels of these blocks (N,)."""
        seen, which, count = np.unique(block, return_inverse=True, return_counts=True)
        decay = ERROR_DECAY**count
        mean = np.bincount(which, square) / count
        self._error[seen] = np.sqrt(decay * self._error[seen] ** 2 + (1 - decay) * mean)

    def state(self) -> dict[str, Tensor]:
        """Return the tensors that a checkpoint stores."""
        return {"error": torch.as_tensor(self._error) if self._on_device is None else self._on_device}

    def load_state(self, state: dict[str, Tensor]) -> None:
        self._error = state["error"].numpy().astype(np.float64).reshape(self._error.shape)
        if self._on_device is not None:
            self._on_device.copy_(torch.as_tensor(self._error))

    def to(self, device: str) -> Tensor:
        """Return the blocks' errors on a device, where they are kept from now on."""
        self._on_device = torch.as_tensor(self._error).to(device)
        return self._on_device


def _blocks(room: NDArray[np.int64], edge: int) -> NDArray[Any]:
    """Blocks of an image as rows of x, y, width, height; what hangs over is cut off, what is empty left out."""
    x = np.arange(0, len(room), edge)
    width = np.minimum(edge, len(room) - x)
    lowest = np.minimum.reduceat(room, x)
    y = np.arange(0, int(room.max(initial=0)), edge)
    height = np.clip(lowest - y[:, None], 0, edge)
    grid = np.broadcast_arrays(x, y[:, None], width, height)
    blocks = np.stack([part.ravel() for part in grid], -1)
    return blocks[blocks[:, 3] > 0]


def _mask_blocks(mask: BoolArray, edge: int) -> NDArray[Any]:
    """The same of a mask (H, W): every marked pixel lies in one block. Blocks across its border are halved until they do not."""
    sums = np.pad(mask.cumsum(0, dtype=np.int64).cumsum(1), ((1, 0), (1, 0)))
    top, left = (part.ravel() for part in np.mgrid[: mask.shape[0] : edge, : mask.shape[1] : edge])
    bottom, right = np.minimum(top + edge, mask.shape[0]), np.minimum(left + edge, mask.shape[1])
    done = [np.zeros((0, 4), np.int64)]
    while len(left):
        marked = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
        whole = marked == (right - left) * (bottom - top)
        done.append(np.stack([left, top, right - left, bottom - top], -1)[whole])
        part = ~whole & (marked > 0)
        top, left, bottom, right = top[part], left[part], bottom[part], right[part]
        x, y = (left + right + 1) // 2, (top + bottom + 1) // 2
        top, bottom = np.concatenate([top, top, y, y]), np.concatenate([y, y, bottom, bottom])
        left, right = np.concatenate([left, x, left, x]), np.concatenate([x, right, x, right])
    return np.concatenate(done)


ImageView = tuple[int, Camera, int]
"""A camera's number among those that are trained on, the camera, a frame."""
Decode = Callable[[Camera, int], NDArray[np.uint8]]
"""Gives an image (H, W, 3) of the camera's size."""
MEMORY_IMAGES, MEMORY_BYTES = 1024, 3 << 30
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

    @property
    def drawable(self) -> NDArray[np.int64] | None:
        """The views (K,) that may be drawn from, increasing; None for all."""

    @property
    def first(self) -> Sequence[int]:
        """The views that the first step may draw from."""

    def image(self, view: int) -> NDArray[np.uint8]:
        """An image (H, W, 3) that may be drawn from."""

    def pixels(
        self, camera: int, view: NDArray[np.int64], y: NDArray[np.int64], x: NDArray[np.int64]
    ) -> NDArray[np.uint8]:
        """Pixels (..., 3) of one camera's views, rows and columns, which are broadcast."""


def bytes_of(views: Sequence[ImageView]) -> list[int]:
    """How large each view's image is."""
    return [3 * camera.model.width * camera.model.height for _, camera, _ in views]


def all_images_fit(views: Sequence[ImageView]) -> bool:
    """Whether so many images are held from the start."""
    return len(views) <= MEMORY_IMAGES and sum(bytes_of(views)) <= MEMORY_BYTES


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
        slots = min(len(views) + AHEAD, max(2 * AHEAD, limit // (3 * self._stride)), MEMORY_IMAGES + AHEAD)
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
        """Bytes of the images' memory."""
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
