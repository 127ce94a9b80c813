"""Adaptive tracing of an image: pixels on a lattice first, then those in blocks whose corners differ.

Pixels between similar corners are interpolated: colours linearly, depths as disparities, which are linear on planes.
Where corners differ a little, the pixel in the block's middle is traced too; if it agrees with the corners' prediction,
the block is interpolated as well. Each block is decided by its own pixels alone, so a part of an image that begins on
the lattice has the bits of the whole image. The pixels that are traced first, for a preview, are pixels of the finished
image.

The numpy functions (``plain_*``) specify which blocks differ, what their corners predict and how pixels are
interpolated, and run without the compiled kernels; the kernels (native/blocks.cpp) give the same bits.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..geometry import FloatArray
from ..native import BlockToleranceStruct, PlaneStruct
from ..sensors.frames import CameraFrame
from ..world.drive import CameraModel
from .tracer import BUNDLE_SIDE_RAYS, Array, Maps


def fill_passes(
    out: CameraFrame,
    maps: Maps,
    along: FloatArray | Array | None,
    shape: tuple[int, ...],
    up: int,
    inner: tuple[slice, slice],
) -> None:
    """Write the passes of rays, one for each cell of ``shape`` (h, w), into a frame. A cell is ``up`` x ``up`` pixels,
    of which rows and columns ``inner`` are kept. ``along`` (h, w), for depths alone, is the component of each cell's
    unit ray along the optical axis."""

    def full(values: NDArray[Any], kind: type[np.generic]) -> NDArray[Any]:
        grid = values.reshape(*shape, *values.shape[1:])
        if up > 1:
            grid = np.repeat(np.repeat(grid, up, 0), up, 1)
        return np.ascontiguousarray(grid[inner], kind)

    if "depth" in maps:
        assert along is not None
        out.depth_m = full(maps["depth"], np.float32)
        out.z_depth_m = (out.depth_m * full(along.reshape(-1), along.dtype.type)).astype(np.float32, copy=False)
    if "normal" in maps:
        out.normal = full(maps["normal"], np.float32)
    if "instance" in maps:
        out.instance = full(maps["instance"], np.int32)
    if "opacity" in maps:
        out.opacity = full(maps["opacity"], np.float32)
    if "unsupported" in maps:
        out.unsupported = full(maps["unsupported"], np.bool_)
    if "confidence" in maps:
        out.confidence = full(maps["confidence"], np.float32)


class Region(NamedTuple):
    """Part of an image, in pixels from its top left corner; ``right`` and ``bottom`` are the first that do
    not belong to it."""

    left: int
    top: int
    right: int
    bottom: int

    @staticmethod
    def of_image(model: CameraModel) -> Region:
        """Return the region of the whole image."""
        return Region(0, 0, model.width, model.height)

    def within_image(self, model: CameraModel) -> Region:
        """Return the part of the region inside the image."""
        spans = (
            (self.left, model.width),
            (self.top, model.height),
            (self.right, model.width),
            (self.bottom, model.height),
        )
        return Region(*(min(max(at, 0), end) for at, end in spans))

    @property
    def area(self) -> int:
        """Number of pixels; 0 where there is none."""
        return max(self.right - self.left, 0) * max(self.bottom - self.top, 0)

    def joined(self, other: Region) -> Region:
        """Return the smallest region that holds both."""
        return Region(
            min(self.left, other.left),
            min(self.top, other.top),
            max(self.right, other.right),
            max(self.bottom, other.bottom),
        )

    def cells(self, size: int, reach: int, whole: Region) -> tuple[slice, slice]:
        """Return rows and columns of the cells of ``size`` pixels that the region overlaps, and ``reach``
        more on every side."""
        spans = ((self.top, self.bottom, whole.bottom), (self.left, self.right, whole.right))
        return tuple(
            slice(max(0, a // size - reach), min(-(-end // size), -(-b // size) + reach)) for a, b, end in spans
        )  # type: ignore[return-value]

    def within(self, cells: tuple[slice, slice], size: int) -> tuple[slice, slice]:
        """Return the rows and columns of the region within the pixels of such cells."""
        rows, columns = (c.start * size for c in cells)
        return slice(self.top - rows, self.bottom - rows), slice(self.left - columns, self.right - columns)


class Tile(NamedTuple):
    """A part of a progressively rendered image, which covers ``region``. Its pixel (i, j) lies at row and column
    ``origin + (i, j) * stride`` of the image and stands for those around it."""

    frame: CameraFrame
    region: Region
    stride: tuple[float, float] = (1, 1)
    first: tuple[float, float] | None = None

    @property
    def origin(self) -> tuple[float, float]:
        """Row and column of its first pixel."""
        return (self.region.top, self.region.left) if self.first is None else self.first


MAX_DISPARITY_RANGE = 0.1
"""Largest relative difference of the corners' depths on one flat surface."""
MAX_DISPARITY_TWIST = 0.01
"""Largest distance of the corners' disparities from one plane, relative to the largest of them."""
NEAR_BOXES = "near_boxes"
"""Name of the map of pixels beside which something thinner than a block may be: all of these are traced."""
EDGE_CONTRAST = 4.0
"""Difference of corners, relative to the allowed one, above which an edge lies between them and nothing is
predicted."""
PREDICTION_TOLERANCE = 0.5
"""Largest difference of a middle from its corners' mean, relative to the corners' allowed difference."""
Blocks = NDArray[np.int64]
"""Rows and columns of blocks' first pixels (N, 2)."""
LABEL_MAPS = ("instance", "unsupported")
MAP_KINDS = {"rgb": 0, "depth": 1, "normal": 2, NEAR_BOXES: 5, **dict.fromkeys(LABEL_MAPS, 4)}
"""Kinds of maps in the kernels, by name. Other maps are of kind 3, numbers, or 6, equal at all corners."""
MAX_CHANNELS = 4


@dataclass
class SparseImage:
    """Colours (h w, 3) and maps (h w, ...), and which pixels (h, w) were traced. Blocks are not decided by the maps
    ``undeciding``."""

    shape: tuple[int, int]
    undeciding: Set[str] = frozenset()
    known: NDArray[np.bool_] = field(init=False)
    values: Maps = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.known = np.zeros(self.shape, bool)

    def put(self, numbers: NDArray[np.int64], maps: Maps) -> None:
        """Set the values of pixels by their flat numbers (N,)."""
        for name, values in maps.items():
            if name not in self.values:
                self.values[name] = np.zeros((self.shape[0] * self.shape[1], *values.shape[1:]), values.dtype)
            self.values[name][numbers] = values

    def decides(self, name: str) -> bool:
        """Return whether blocks are decided by a map."""
        return name in self.values and name not in self.undeciding

    def corners(self, name: str, blocks: Blocks, size: int) -> NDArray[Any]:
        """Return the values (4, N, ...) at the corners of blocks."""
        y, x = blocks.T
        number = y * self.shape[1] + x
        steps = np.array([0, size, size * self.shape[1], size * self.shape[1] + size])
        return self.values[name][steps[:, None] + number]


def differ(image: SparseImage, blocks: Blocks, size: int, spread: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which blocks (N,) have corners that differ, and for which others the middles decide: (N,) bool each."""
    planes = _planes(image, deciding=True)
    if planes is None:
        return plain_differ(image, blocks, size, spread)
    verdict = np.empty(len(blocks), np.uint8)
    _call("differ", planes, image, blocks, size, ctypes.byref(block_tolerance(spread)), verdict.ctypes.data)
    return verdict == 1, verdict == 2


def predicted(image: SparseImage, blocks: Blocks, size: int, spread: float) -> NDArray[np.bool_]:
    """Return whether the traced middles of blocks (N,) agree with the prediction of their corners: (N,) bool."""
    planes = _planes(image, deciding=True)
    if planes is None:
        return plain_predicted(image, blocks, size, spread)
    alike = np.empty(len(blocks), bool)
    _call("predicted", planes, image, blocks, size, ctypes.byref(block_tolerance(spread)), alike.ctypes.data)
    return alike


def fill(image: SparseImage, blocks: Blocks, size: int) -> None:
    """Interpolate the pixels that were not traced in blocks (N,) with similar corners: bilinear, with a correction
    towards a traced middle that falls to 0 at the block's edges."""
    planes = _planes(image)
    if planes is None:
        return plain_fill(image, blocks, size)
    _call("fill", planes, image, blocks, size, image.known.ctypes.data)


def _planes(image: SparseImage, deciding: bool = False) -> ctypes.Array[PlaneStruct] | None:
    """Return an image's maps, or the ``deciding`` ones, as the kernels read them; None where they cannot."""
    if native.library() is None:
        return None
    planes = []
    for name, values in image.values.items():
        if deciding and not image.decides(name):
            continue
        number = values.dtype.kind == "f"
        kind = MAP_KINDS.get(name, 3 if number else 6)
        channels = values[0].size
        if kind < 4 and (values.dtype != np.float32 or channels > MAX_CHANNELS or (name == "normal" and channels != 3)):
            return None
        if kind >= 4 and number:
            return None
        planes.append(
            PlaneStruct(values.ctypes.data, channels, values.itemsize if kind < 4 else values[0].nbytes, kind)
        )
    return (PlaneStruct * len(planes))(*planes)


def block_tolerance(spread: float) -> BlockToleranceStruct:
    """Return how much the corners of a block may differ, for a largest difference of their colours."""
    return BlockToleranceStruct(
        spread, EDGE_CONTRAST * spread, PREDICTION_TOLERANCE * spread, MAX_DISPARITY_RANGE, MAX_DISPARITY_TWIST
    )


def _call(
    name: str, planes: ctypes.Array[PlaneStruct], image: SparseImage, blocks: Blocks, size: int, *rest: Any
) -> None:
    blocks = np.ascontiguousarray(blocks)
    getattr(native.library(), f"unisim_blocks_{name}")(
        planes, len(planes), blocks.ctypes.data, len(blocks), image.shape[1], size, *rest, native.threads()
    )


def plain_differ(
    image: SparseImage, blocks: Blocks, size: int, spread: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """`differ` in numpy."""
    rgb = image.corners("rgb", blocks, size)
    range_of = (rgb.max(0) - rgb.min(0)).max(1)
    apart = range_of > EDGE_CONTRAST * spread
    if NEAR_BOXES in image.values:
        apart |= image.corners(NEAR_BOXES, blocks, size).any(0)
    for name in ("instance", "unsupported"):
        if image.decides(name):
            values = image.corners(name, blocks, size)
            apart |= (values != values[0]).any(0)
    if image.decides("depth"):
        disparity = 1 / image.corners("depth", blocks, size)
        largest = disparity.max(0)
        twist = np.abs(disparity[0] + disparity[3] - disparity[1] - disparity[2])
        apart |= (largest - disparity.min(0) > MAX_DISPARITY_RANGE * largest) | (twist > MAX_DISPARITY_TWIST * largest)
    return apart, (range_of > spread) & ~apart


def plain_predicted(image: SparseImage, blocks: Blocks, size: int, spread: float) -> NDArray[np.bool_]:
    """`predicted` in numpy."""
    y, x = (blocks + size // 2).T
    number = y * image.shape[1] + x
    rgb = image.corners("rgb", blocks, size)
    alike = np.abs(image.values["rgb"][number] - rgb.mean(0)).max(1) <= PREDICTION_TOLERANCE * spread
    for name in ("instance", "unsupported"):
        if image.decides(name):
            alike &= image.values[name][number] == image.corners(name, blocks, size)[0]
    if image.decides("depth"):
        disparity = 1 / image.corners("depth", blocks, size)
        alike &= np.abs(1 / image.values["depth"][number] - disparity.mean(0)) <= MAX_DISPARITY_TWIST * disparity.max(0)
    return alike


def plain_fill(image: SparseImage, blocks: Blocks, size: int) -> None:
    """`fill` in numpy."""
    steps = np.arange(size, dtype=np.float32) / np.float32(size)
    tent = 1 - np.abs(2 * steps - 1)
    tent = (tent[:, None] * tent).reshape(-1, 1)
    v, u = (x.reshape(-1, 1) for x in np.meshgrid(steps, steps, indexing="ij"))
    weights = np.stack([(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u])
    y, x = blocks.T
    inner = (np.arange(size)[:, None] * image.shape[1] + np.arange(size)).reshape(-1, 1)
    numbers = inner + (y * image.shape[1] + x)
    middle = numbers[size // 2 * (size + 1)]
    asked = image.known.reshape(-1)[middle]
    unknown = ~image.known.reshape(-1)[numbers]
    numbers = numbers[unknown]
    for name, values in image.values.items():
        corners = image.corners(name, blocks, size)
        if values.dtype.kind != "f":
            # alike in all four
            values[numbers] = np.broadcast_to(corners[0], unknown.shape)[unknown]
            continue
        at = 1 / corners if name == "depth" else corners
        beside = (1,) * (at.ndim - 1)
        mixed = sum(w.reshape(-1, *beside) * c for w, c in zip(weights, at, strict=True))
        traced = values[middle[asked]]
        mixed[:, asked] += tent.reshape(-1, *beside) * (
            (1 / traced if name == "depth" else traced) - at[:, asked].mean(0)
        )
        mixed = mixed[unknown]
        if name == "normal":
            x, y, z = mixed.T
            mixed /= np.maximum(np.sqrt(x * x + y * y + z * z), np.float32(1e-12))[:, None]
        with np.errstate(divide="ignore"):
            values[numbers] = 1 / mixed if name == "depth" else mixed


Trace = Callable[[NDArray[np.int64]], tuple[Array, Maps]]
"""Function from flat numbers (N,) of pixels to their colours (N, 3) and maps (N, ...)."""


def aligned(cells: tuple[slice, slice], size: int, shape: tuple[int, int]) -> tuple[slice, slice]:
    """Return rows and columns of an image of ``shape`` (h, w), dilated to where a lattice of ``size`` begins and ends.

    A block before rows or columns that begin on the lattice is included: it may have their pixels traced.
    """
    rows, columns = (
        slice(max(0, part.start - 1) // size * size, min(end, ((part.stop - 1) // size + 1) * size + 1))
        for part, end in zip(cells, shape, strict=True)
    )
    return rows, columns


def progressive_strides(
    image: SparseImage, size: int, spread: float, trace: Trace, coarse: Sequence[int] = (), band: int | None = None
) -> Iterator[tuple[int, slice]]:
    """Fill an image from a lattice of ``size``, a power of two, and yield what is finished: a stride and rows.

    ``spread`` is the largest difference of colours between corners that are interpolated. First every stride-th pixel
    of every stride-th row, for those strides of ``coarse`` that are multiples of ``size``; then, with stride 1,
    finished bands of ``band`` rows or a few less, from the top.
    """
    h, w = image.shape
    last = (h - 1) // size * size, (w - 1) // size * size
    for stride in coarse:
        if stride > size and stride % size == 0:
            _take(image, _numbers(np.arange(0, h, stride), np.arange(0, w, stride), w), stride, trace)
            yield stride, slice(0, h)
    step = h if band is None else max(size, band // size * size)
    for top in range(0, h, step):
        bottom = min(top + step, h)
        wanted = np.zeros((min(bottom + 1, h) - top, w), bool)
        # the next band's first line has corners of this one's blocks
        wanted[0 : last[0] + 1 - top : size, 0 : last[1] + 1 : size] = True
        # on the last lines and beyond them no block begins
        wanted[: bottom - top, last[1] :] = True
        wanted[max(0, last[0] - top) : bottom - top] = True
        _take(image, np.flatnonzero(wanted) + top * w, size, trace)
        y, x = np.mgrid[top : min(bottom, last[0]) : size, 0 : last[1] : size]
        _refine(image, np.stack([y.reshape(-1), x.reshape(-1)], 1), size, spread, trace)
        yield 1, slice(top, bottom)


def _refine(image: SparseImage, blocks: Blocks, size: int, spread: float, trace: Trace) -> None:
    """Fill blocks whose corners are known. Blocks above and to the left are filled already, or among these."""
    leaves, w = [], image.shape[1]
    while size > 1 and len(blocks):
        half = size // 2
        apart, doubtful = differ(image, blocks, size, spread)
        _take(image, (blocks[doubtful] + half) @ np.array([w, 1]), half, trace)
        apart[doubtful] = ~predicted(image, blocks[doubtful], size, spread)
        leaves.append((blocks[~apart], size))
        blocks = blocks[apart]
        first = blocks[:, 0] * w + blocks[:, 1]
        steps = np.array([half, half * w, half * w + half, size * w + half, half * w + size])
        wanted = np.zeros(image.known.size, bool)
        for step in steps:
            wanted[first + step] = True
        _take(image, np.flatnonzero(wanted), half, trace)
        blocks = np.concatenate([blocks + step for step in ((0, 0), (0, half), (half, 0), (half, half))])
        size = half
    for blocks, size in leaves:
        fill(image, blocks, size)


def _numbers(rows: NDArray[np.int64], columns: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """Return the flat numbers of the pixels in rows and columns."""
    numbers: NDArray[np.int64] = (rows[:, None] * width + columns).reshape(-1)
    return numbers


def _take(image: SparseImage, numbers: NDArray[np.int64], stride: int, trace: Trace) -> None:
    """Trace those of the pixels that are not known, about ``stride`` apart, neighbours next to each other."""
    known = image.known.reshape(-1)
    numbers = numbers[~known[numbers]]
    if len(numbers) == 0:
        return
    side, width = BUNDLE_SIDE_RAYS * stride, image.shape[1]
    y, x = np.divmod(numbers, width)
    tile = y // side * (width // side + 1) + x // side
    # numpy counts what fits in sixteen bits, and merges the rest
    numbers = numbers[np.argsort(tile.astype(np.uint16) if tile.max() < 1 << 16 else tile, kind="stable")]
    rgb, maps = trace(numbers)
    image.put(numbers, {"rgb": rgb, **maps})
    known[numbers] = True
