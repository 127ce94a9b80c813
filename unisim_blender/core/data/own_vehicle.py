"""The recording vehicle's own body in its cameras' images: a bonnet, a roof. It moves with the cameras, so it is not
part of the scene.

It is found from the images alone: its outline stays in place while everything else moves.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..errors import LogError
from ..geometry import BoolArray, FloatArray
from ..json_file import Node
from ..world.drive import CameraModel, Drive
from .log import Log, extras_of

LEAST_IMAGES = 8
LEAST_MOVED_M = 0.5
"""Smallest number of images in which an outline is sought, and smallest distance, metres, between two of them: while
the vehicle stands, everything stays in place."""
WIDTH = 480
"""Approximate width, pixels, to which images are reduced before an outline is sought."""
LASTING_MEAN, LASTING_LOW = 0.85, 0.8
"""Smallest constancy of an edge over all images that makes it the vehicle's outline: the mean along the outline, and
its 10th percentile. 1 is an edge that is the same in every image. In a recorded drive with six cameras, the one camera
that shows the vehicle has 0.95 and 0.93; the others have at most 0.73 and 0.60."""
OUTSIDE_COST = 0.3
"""Cost of a column in which an outline leaves what a lens shows: more than that of a constant edge, less than any
other."""
LEAST_KNOWN = 0.3
"""Smallest share of the columns with known pixels in which an outline must lie among these."""
STEEPEST = 3
"""Largest number of rows by which an outline rises or falls from one column of pixels to the next."""
MARGIN_ROWS = 2

Outline = NDArray[np.int64]
"""The upper edge of the vehicle in an image: for each column of pixels, (W,), the number of the topmost row that shows
the vehicle."""


def moved_frames(drive: Drive, frames: Sequence[int]) -> list[int]:
    """Return the frames of the drive that are among ``frames`` and between which the vehicle moves."""
    moved: list[int] = []
    last: NDArray[np.float64] | None = None
    there = [frame for frame in frames if frame in drive.time_s]
    places = drive.world_from_ego.positions_at(np.array([drive.time_s[frame] for frame in there]))
    for frame, place in zip(there, places, strict=True):
        if last is None or np.linalg.norm(place - last) >= LEAST_MOVED_M:
            moved.append(frame)
            last = place
    return moved


def find_outline(images: Sequence[NDArray[np.uint8]], shown: BoolArray | None = None) -> Outline | None:
    """Return the outline of the vehicle in images (H, W, 3) between which it moves; None where it is not in them, or
    there are too few. ``shown`` (H, W) bool: the pixels that the lens shows, where it does not show all; their border
    stays in place, too, and is no outline."""
    if len(images) < LEAST_IMAGES:
        return None
    height, width = images[0].shape[:2]
    step = max(1, round(width / WIDTH))
    total = np.zeros((2, -(-height // step), -(-width // step)))
    size = np.zeros(total.shape[1:])
    for image in images:
        grey = _smaller_grey(image, step)
        gradient = np.stack([_filtered(_filtered(grey, _SMOOTH, 1 - axis), _SLOPE, axis) for axis in (1, 0)])
        total += gradient
        size += np.hypot(*gradient)
    lasting = np.hypot(*total) / (size + len(images))
    top = lasting.shape[0] // 2
    telling = np.ones(lasting.shape, bool) if shown is None else _well_inside(shown, step)
    rows = _seam(np.where(telling, 1 - lasting, OUTSIDE_COST)[top:]) + top
    is_known = telling[rows, np.arange(len(rows))]
    along = lasting[rows, np.arange(len(rows))][is_known]
    if is_known.sum() < max(1, LEAST_KNOWN * telling.any(0).sum()):
        return None
    if along.mean() < LASTING_MEAN or np.percentile(along, 10) < LASTING_LOW:
        return None
    fine = np.interp(np.arange(width) + 0.5, (np.arange(len(rows)) + 0.5) * step, rows * float(step))
    return np.asarray(np.clip(np.floor(fine) - MARGIN_ROWS * step, 0, height), np.int64)


def given_outline(log: Log, camera: str, model: CameraModel) -> Outline | None:
    """Return the outline, at the model's size, of the vehicle in the log's mask of a camera; None where there is no
    mask.

    An outline has one row for each column, so what lies beneath a marked pixel counts as the vehicle, too. Marked pixels of an
    image's upper half (a roof's edge) have no outline: they are left in, with a warning.
    Raises `LogError` for a mask of another size or kind.
    """
    given = extras_of(log).own_vehicle_mask(camera)
    if given is None:
        return None
    recorded, mask = log.drive.cameras[camera].model, np.asarray(given)
    if mask.dtype != np.bool_ or mask.shape != (recorded.height, recorded.width):
        raise LogError(
            f"{log.path}: the mask of {camera} is {mask.dtype} {mask.shape}, not bool ({recorded.height}, {recorded.width})"
        )
    half = recorded.height // 2
    if mask[:half].any():
        high = int(mask[:half].sum())
        warnings.warn(
            f"{log.path}: {high} pixels of the upper half in the mask of {camera} are not left out", stacklevel=2
        )
    low = mask[half:]
    if not low.any():
        return None
    first = np.where(low.any(0), low.argmax(0) + half, recorded.height)
    begins = np.arange(model.width) * recorded.width // model.width
    rows = np.minimum.reduceat(first, begins)
    return np.asarray(np.floor(rows * (model.height / recorded.height)), np.int64)


def joined(estimated: Outline | None, given: Outline | None) -> Outline | None:
    """Return the outline of the union of two outlines in images of one size."""
    if estimated is None or given is None:
        return given if estimated is None else estimated
    return np.minimum(estimated, given)


def _well_inside(shown: BoolArray, step: int) -> BoolArray:
    """Pixels of images made smaller by ``step`` whose gradients come from pixels that are shown."""
    small = shown[: shown.shape[0] // step * step, : shown.shape[1] // step * step]
    small = small.reshape(small.shape[0] // step, step, -1, step).all((1, 3))
    small = np.pad(small, [(0, -(-n // step) - m) for n, m in zip(shown.shape, small.shape, strict=True)], mode="edge")
    reach = 2 * (len(_SMOOTH) // 2)
    for axis in (0, 1):
        ends = [(reach, reach) if i == axis else (0, 0) for i in (0, 1)]
        small = sliding_window_view(np.pad(small, ends, mode="edge"), 2 * reach + 1, axis).all(-1)
    return np.asarray(small)


_SMOOTH = np.exp(-0.5 * np.arange(-4, 5.0) ** 2)
_SMOOTH /= _SMOOTH.sum()
_SLOPE = np.arange(-4, 5.0) * _SMOOTH
"""Slope of `_SMOOTH`, a Gaussian of one pixel."""


def _filtered(values: NDArray[np.float64], weights: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Weighted sums of neighbours along an axis, mirrored at the ends, as scipy's `correlate1d`,
    which Blender lacks."""
    return np.asarray(sliding_window_view(_mirrored(values, len(weights), axis), len(weights), axis) @ weights)


def _smaller_grey(image: NDArray[np.uint8], step: int) -> NDArray[np.float64]:
    """Return an image's (H, W, 3) grey: every ``step``-th row and column of `_filtered` means over ``step`` rows and
    columns.

    Sums of whole numbers are exact in any order, so rows are added up as they lie in memory, and are few from there on.
    """
    rows = _sums_of(image, step, 0)
    return np.asarray(_sums_of(rows[..., 0] + rows[..., 1] + rows[..., 2], step, 1) / (3.0 * step * step))


def _sums_of(values: NDArray[Any], count: int, axis: int) -> NDArray[np.uint32]:
    """Sums over so many neighbours along an axis, of every ``count``-th value, mirrored at the ends."""
    parts = -(-values.shape[axis] // count)
    padded = np.moveaxis(_mirrored(values, count, axis), axis, 0)[: parts * count]
    split = np.moveaxis(padded.reshape(parts, count, *padded.shape[1:]), (0, 1), (axis, axis + 1))
    return np.asarray(split.sum(axis + 1, dtype=np.uint32))


def _mirrored(values: NDArray[Any], count: int, axis: int) -> NDArray[Any]:
    """Return values with as many more at both ends of an axis as make ``count`` neighbours of each."""
    before = count // 2
    ends = [(0, 0)] * values.ndim
    ends[axis] = (before, count - 1 - before)
    return np.pad(values, ends, mode="symmetric")


def _seam(cost: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the row (W,) of the cheapest way through a cost map (H, W) from its left to its right, by dynamic
    programming."""
    height, width = cost.shape
    best = cost[:, 0]
    came = np.zeros((width, height), np.int64)
    offsets = np.arange(-STEEPEST, STEEPEST + 1)
    padded = np.full(height + 2 * STEEPEST, np.inf)
    reached, bends = sliding_window_view(padded, len(offsets)), 0.02 * abs(offsets)
    for x, column in enumerate(np.ascontiguousarray(cost.T[1:]), 1):
        padded[STEEPEST:-STEEPEST] = best
        choices = reached + bends
        least = choices.argmin(1)
        came[x] = offsets[least]
        best = choices[np.arange(height), least] + column
    rows = np.zeros(width, np.int64)
    rows[-1] = best.argmin()
    for x in range(width - 1, 0, -1):
        rows[x - 1] = rows[x] + came[x, rows[x]]
    return rows


def shows_scene(outline: Outline, height: int, u: FloatArray, v: FloatArray, size: tuple[int, int]) -> BoolArray:
    """Return which points u, v (...), pixels, of an image of ``size`` (width, height) show the scene and not the
    vehicle, whose outline was found in images ``height`` pixels high: (...) bool."""
    columns = np.clip((u / size[0] * len(outline)).astype(np.int64), 0, len(outline) - 1)
    return np.asarray(v / size[1] < outline[columns] / height)


def outlines_to_json(outlines: dict[str, tuple[Outline, int]]) -> dict[str, Any]:
    """Return the JSON form, in a trained scene's header, of outlines by camera with the height of their images."""
    return {name: {"height": height, "rows": outline.tolist()} for name, (outline, height) in outlines.items()}


def outlines_from_json(value: Any) -> dict[str, tuple[Outline, int]]:
    """Return the outlines of `outlines_to_json`; none for any other value."""
    outlines = value if isinstance(value, dict) else {}
    return {
        str(name): (np.array(outline["rows"], np.int64), int(outline["height"])) for name, outline in outlines.items()
    }


def check_outlines(node: Node) -> Any:
    """Return the JSON value of outlines by camera. Raises the node's error for any other value."""
    for _, outline in node.members():
        outline.key("height").integer(at_least=1)
        if not len(outline.key("rows").array(-1)):
            outline.key("rows").fail("is empty")
    return node.value
