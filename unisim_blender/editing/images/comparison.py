"""A recorded image beside a rendered one: which view has one, how its pixels lie in that view, and how the two differ.
A thread decodes and resamples recorded images; the newest are cached, and the next one is fetched before it is asked
for.

Images here have their lowest row first, as Blender's have.
"""

from __future__ import annotations

from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...core.colour import linear_from_srgb
from ...core.data.log import Log
from ...core.errors import UnisimError
from ...core.world.drive import CameraModel, Drive
from ..sampled.scene import SampledObject
from ..texts import Text

INTRINSIC_MEMBERS = {"id", "width", "height", "fx", "fy", "cx", "cy", "shutter", "lens"}
"""Members that a scenario may state of a camera that stands where it recorded: its intrinsics alone differ."""
LINEAR = linear_from_srgb(np.arange(256, dtype=np.float32) / 255)
"""By eight-bit sRGB."""
STRIPE_PX = 6
"""Width of the hatching's stripes and of the gaps between them, in pixels."""
HATCH_RGB, HATCH_ALPHA = (1.0, 0.02, 0.02), 0.4
"""Linear colour and opacity of the hatching over unsupported pixels."""
DOUBTED_RGB, WRONG_RGB, DOUBT_ALPHA = (1.0, 0.6, 0.0), (1.0, 0.02, 0.02), 0.6
"""Linear colours over doubted pixels, those of half of the doubt and of all, and the opacity over the latter."""
NO_DOUBT, FULL_DOUBT = 0.8, 0.2
"""Confidence from which on a pixel has no colour, and below which it has the full one."""
MOST_DB = 99.0
"""Largest PSNR, which equal images have, dB."""
Key = TypeVar("Key")
Value = TypeVar("Value")
PixelRectangle = tuple[int, int, int, int]
"""Left, bottom, width, height in pixels of a region."""


@dataclass(frozen=True)
class ImagePlacement:
    """Placement of a recorded image in a view of ``size`` (width, height): ``box`` (left, top, right, bottom) of the
    image, in its pixels, fills ``place`` (left, top, right, bottom) of the view. Beside that the camera recorded
    nothing."""

    size: tuple[int, int]
    box: tuple[float, float, float, float]
    place: tuple[int, int, int, int]


def placement(recorded: CameraModel, shown: CameraModel) -> ImagePlacement | None:
    """Return how an image of camera model ``recorded`` lies in the view of the model ``shown``, from the same place;
    None where they share no pixel, or have lenses that differ."""
    if recorded.lens != shown.lens:
        return None
    across = _placed(recorded.width, recorded.fx, recorded.cx, shown.width, shown.fx, shown.cx)
    down = _placed(recorded.height, recorded.fy, recorded.cy, shown.height, shown.fy, shown.cy)
    if across is None or down is None:
        return None
    return ImagePlacement(
        (shown.width, shown.height), (across[0], down[0], across[1], down[1]), (across[2], down[2], across[3], down[3])
    )


def _placed(
    length: int, f: float, c: float, length_shown: int, f_shown: float, c_shown: float
) -> tuple[float, float, int, int] | None:
    """Along one axis: where the box begins and ends, in the recorded pixels, and its place, in the view's."""
    scale = f_shown / f
    begin, end = c_shown - c * scale, c_shown + (length - c) * scale
    # a view's last pixel counts if it is covered but for rounding
    first, last = max(0, int(np.ceil(begin - 0.01))), min(length_shown, int(np.floor(end + 0.01)))
    if last <= first:
        return None
    return max(0.0, (first - begin) / scale), min(float(length), (last - begin) / scale), first, last


def lacks_recorded(view: SampledObject, scenario: dict[str, Any], drive: Drive, log: Log | None, frame: float) -> str:
    """Return one sentence that says why nothing was recorded in a view at a frame; "" where an image was.

    ``scenario`` is what the view is rendered by, as a JSON object.
    """
    if view.kind != "CAMERA":
        return Text("This view has no recorded image: look through a recorded camera (Numpad 0)")
    if view.uid not in drive.cameras or not view.is_original:
        return Text("{camera} is an added camera: it has no recorded image", camera=view.name)
    cameras = (scenario.get("sensors") or {}).get("cameras") or ()
    moved = any(set(camera) - INTRINSIC_MEMBERS for camera in cameras if camera["id"] == view.uid)
    if moved or any(edit["type"] == "ego" for edit in scenario.get("edits", ())):
        return Text("{camera} is not where it recorded: no recorded image shows this view", camera=view.name)
    if log is None:
        return Text("The log is not at hand: there are no recorded images")
    if frame != int(frame) or int(frame) not in log.image_frames(view.uid):
        return Text("{camera} has no recorded image of frame {frame:g}", camera=view.name, frame=float(frame))
    return ""


def visible(rectangle: PixelRectangle, region: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of the image in ``rectangle`` that a region of that size (width, height) shows."""
    left, bottom, width, height = rectangle
    spans = ((bottom, height, region[1]), (left, width, region[0]))
    rows, columns = (slice(max(0, -start), max(0, min(length, end - start))) for start, length, end in spans)
    return rows, columns


def difference(
    recorded: NDArray[np.uint8], covered: NDArray[np.bool_], rendered: NDArray[np.uint8], gain: float
) -> NDArray[np.float32]:
    """Return |recorded - rendered| times ``gain`` of images (H, W, 3), eight-bit sRGB, as linear premultiplied RGBA
    (H, W, 4); transparent where the recorded image does not cover the view (H, W)."""
    assert recorded.shape == rendered.shape == (*covered.shape, 3), (recorded.shape, rendered.shape, covered.shape)
    apart = np.abs(recorded.astype(np.int16) - rendered)
    out = np.empty((*covered.shape, 4), np.float32)
    out[..., :3] = LINEAR[np.minimum(np.rint(apart * np.float32(gain)), 255).astype(np.uint8)]
    out[..., 3] = 1.0
    out[~covered] = 0.0
    return out


def errors(
    recorded: NDArray[np.uint8], covered: NDArray[np.bool_], rendered: NDArray[np.uint8]
) -> tuple[float, float] | None:
    """Return the mean absolute error, in steps of eight bits, and the PSNR in dB of images (H, W, 3) where the recorded
    one covers the view (H, W); None where it does so nowhere."""
    assert recorded.shape == rendered.shape == (*covered.shape, 3), (recorded.shape, rendered.shape, covered.shape)
    if not covered.any():
        return None
    apart = (recorded.astype(np.int16) - rendered)[covered].astype(np.float32)
    squared = float(np.mean(np.square(apart), dtype=np.float64))
    psnr = MOST_DB if squared == 0 else min(MOST_DB, 10 * float(np.log10(255**2 / squared)))
    return float(np.mean(np.abs(apart), dtype=np.float64)), psnr


def hatched(image: NDArray[np.float32], unsupported: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return a linear premultiplied image (H, W, 4) with diagonal red stripes over unsupported pixels (H, W)."""
    assert image.shape == (*unsupported.shape, 4), (image.shape, unsupported.shape)
    height, width = unsupported.shape
    stripes = (np.arange(height + width) // STRIPE_PX) % 2 == 0
    diagonal = np.lib.stride_tricks.sliding_window_view(stripes, width)[:height]  # pixel (y, x) is of stripe y + x
    over = np.flatnonzero(unsupported & diagonal)
    out = image.copy()
    pixels = out.reshape(-1, 4)
    pixels[over] = (1 - HATCH_ALPHA) * pixels[over] + HATCH_ALPHA * np.array([*HATCH_RGB, 1.0], np.float32)
    return out


def tint(confidence: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the premultiplied linear colours (..., 4) over pixels of a confidence (...): clear, orange, red."""
    doubt = np.clip((NO_DOUBT - confidence) / (NO_DOUBT - FULL_DOUBT), 0, 1)[..., None]
    wrong = np.clip(2 * doubt - 1, 0, 1)
    rgb = (1 - wrong) * np.array(DOUBTED_RGB, np.float32) + wrong * np.array(WRONG_RGB, np.float32)
    return np.asarray(DOUBT_ALPHA * doubt * np.concatenate([rgb, np.ones_like(doubt)], -1), np.float32)


def tinted(image: NDArray[np.float32], confidence: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a linear premultiplied image (H, W, 4) under the `tint` of its confidence (H, W)."""
    assert image.shape == (*confidence.shape, 4), (image.shape, confidence.shape)
    over = tint(confidence)
    return image * (1 - over[..., 3:]) + over


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
        return str(self.log.path), self.camera, self.frame, self.placement


@dataclass(frozen=True, eq=False)
class ShownImage:
    """A recorded image at a view's size, lowest row first: ``srgb`` (H, W, 3) eight bits, ``covered`` (H, W) where the
    camera recorded something, ``linear`` (H, W, 4) premultiplied. ``problem`` is a sentence where it cannot be read;
    the rest is then empty."""

    srgb: NDArray[np.uint8]
    covered: NDArray[np.bool_]
    linear: NDArray[np.float32]
    problem: str = ""


class RecordedImages:
    """Loads and keeps recorded images in a thread; no method waits for a file."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._decoded: OrderedDict[tuple[str, str, int], NDArray[np.uint8]] = OrderedDict()
        """The thread's own."""
        self._shown: OrderedDict[tuple[object, ...], Future[ShownImage]] = OrderedDict()

    def get(self, request: RecordedImageRequest) -> ShownImage | None:
        """The image, if it is there; else it is fetched, and there a few drawings later."""
        image = self.fetch(request)
        return image.result() if image.done() else None

    def fetch(self, request: RecordedImageRequest) -> Future[ShownImage]:
        """Have an image ready for when it is asked for."""
        if request.key not in self._shown:
            if self._pool is None:
                self._pool = ThreadPoolExecutor(1, "recorded images")
            self._shown[request.key] = self._pool.submit(self._load, request)
        return _newest(self._shown, request.key, MOST_SHOWN)

    def close(self) -> None:
        """Forget all images, and end the thread."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool, self._decoded, self._shown = None, OrderedDict(), OrderedDict()

    def _load(self, request: RecordedImageRequest) -> ShownImage:
        key = str(request.log.path), request.camera, request.frame
        try:
            if key not in self._decoded:
                self._decoded[key] = request.log.image(request.camera, request.frame)
            return resampled(_newest(self._decoded, key, MOST_DECODED), request.placement)
        except (UnisimError, OSError, ModuleNotFoundError) as fault:
            return _failed(str(fault))
        except Exception as fault:  # a thread's fault would be lost
            return _failed(f"{request.log.path}: the image of {request.camera}, frame {request.frame}: {fault}")


def _newest(cache: OrderedDict[Key, Value], key: Key, most: int) -> Value:
    """Return what a cache has for a key, which counts as its newest now; of older ones ``most`` - 1 stay."""
    cache.move_to_end(key)
    while len(cache) > most:
        cache.popitem(last=False)
    return cache[key]


def resampled(image: NDArray[np.uint8], placement: ImagePlacement) -> ShownImage:
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
    return ShownImage(srgb, covered, linear)


def _failed(problem: str) -> ShownImage:
    return ShownImage(np.zeros((0, 0, 3), np.uint8), np.zeros((0, 0), bool), np.zeros((0, 0, 4), np.float32), problem)
