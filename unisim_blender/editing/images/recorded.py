"""Recorded images as a view shows them: decoded and resampled in a thread, the newest kept, the next one fetched before
it is asked for."""

from __future__ import annotations

import threading
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...core.data.log import Log
from ...core.errors import UnisimError
from .comparison import LINEAR, ImagePlacement

MOST_DECODED, MOST_SHOWN = 8, 6
"""Largest numbers of cached images, as recorded and as views show them: 6 MB each, and 8 MB, at 1920x1080."""


@dataclass(frozen=True)
class RecordedImageRequest:
    """The recorded image of a camera's frame, as it lies in a view."""

    log: Log
    camera: str
    frame: int
    placement: ImagePlacement

    @property
    def key(self) -> tuple[object, ...]:
        """Key that distinguishes the request from others."""
        return str(self.log.path), self.camera, self.frame, self.placement


@dataclass(frozen=True, eq=False)
class Shown:
    """A recorded image at a view's size, lowest row first: ``srgb`` (H, W, 3) eight bits, ``covered`` (H, W) where the
    camera recorded something, ``linear`` (H, W, 4) premultiplied. ``problem`` is a sentence where it cannot be read;
    the rest is then empty."""

    srgb: NDArray[np.uint8]
    covered: NDArray[np.bool_]
    linear: NDArray[np.float32]
    problem: str = ""


class RecordedImages:
    """Loads and keeps recorded images; no method waits for a file."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pool: ThreadPoolExecutor | None = None
        self._decoded: OrderedDict[tuple[str, str, int], NDArray[np.uint8]] = OrderedDict()
        self._shown: OrderedDict[tuple[object, ...], Shown] = OrderedDict()
        self._loading: set[tuple[object, ...]] = set()

    def get(self, request: RecordedImageRequest) -> Shown | None:
        """The image, if it is there; else it is fetched, and there a few drawings later."""
        with self._lock:
            found = self._shown.get(request.key)
            if found is not None:
                self._shown.move_to_end(request.key)
                return found
        self.fetch(request)
        return None

    def fetch(self, request: RecordedImageRequest) -> None:
        """Have an image ready for when it is asked for."""
        with self._lock:
            if request.key in self._shown or request.key in self._loading:
                return
            self._loading.add(request.key)
            if self._pool is None:
                self._pool = ThreadPoolExecutor(1, "recorded images")
            self._pool.submit(self._load, request)

    def close(self) -> None:
        """Forget all images, and end the thread."""
        with self._lock:
            pool, self._pool = self._pool, None
            self._decoded.clear()
            self._shown.clear()
        if pool is not None:
            pool.shutdown(wait=False, cancel_futures=True)
        with self._lock:
            self._loading.clear()

    def _load(self, request: RecordedImageRequest) -> None:
        try:
            shown = resampled(self._image(request), request.placement)
        except (UnisimError, OSError, ModuleNotFoundError) as fault:
            shown = _failed(str(fault))
        except Exception as fault:  # a thread's fault would be lost
            shown = _failed(f"{request.log.path}: the image of {request.camera}, frame {request.frame}: {fault}")
        with self._lock:
            self._shown[request.key] = shown
            self._loading.discard(request.key)
            while len(self._shown) > MOST_SHOWN:
                self._shown.popitem(last=False)

    def _image(self, request: RecordedImageRequest) -> NDArray[np.uint8]:
        """The recorded image (H, W, 3), decoded once for all views and sizes."""
        key = str(request.log.path), request.camera, request.frame
        with self._lock:
            found = self._decoded.get(key)
            if found is not None:
                self._decoded.move_to_end(key)
                return found
        image = request.log.image(request.camera, request.frame)
        with self._lock:
            self._decoded[key] = image
            while len(self._decoded) > MOST_DECODED:
                self._decoded.popitem(last=False)
        return image


def resampled(image: NDArray[np.uint8], placement: ImagePlacement) -> Shown:
    """Return a recorded image (H, W, 3), first row on top, as it lies in a view: where it gets smaller each pixel is
    the mean of what it covers, where it gets larger colours are interpolated, where it stays as it is none changes."""
    from PIL import Image

    width, height = placement.size
    left, top, right, bottom = placement.place
    size = right - left, bottom - top
    across, down = placement.box[2] - placement.box[0], placement.box[3] - placement.box[1]
    smaller = size[0] <= across and size[1] <= down
    filtered = Image.Resampling.BOX if smaller else Image.Resampling.BILINEAR
    part = np.asarray(Image.fromarray(image).resize(size, filtered, box=placement.box))
    srgb, covered = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), bool)
    srgb[height - bottom : height - top, left:right] = part[::-1]
    covered[height - bottom : height - top, left:right] = True
    linear = np.zeros((height, width, 4), np.float32)
    linear[..., :3] = LINEAR[srgb]
    linear[..., 3] = covered
    return Shown(srgb, covered, linear)


def _failed(problem: str) -> Shown:
    return Shown(np.zeros((0, 0, 3), np.uint8), np.zeros((0, 0), bool), np.zeros((0, 0, 4), np.float32), problem)
