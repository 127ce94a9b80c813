"""Parts of an image: regions to render, and the tiles of progressive rendering."""

from __future__ import annotations

from typing import NamedTuple

from ..sensors.frames import CameraFrame
from ..world.drive import CameraModel


class Region(NamedTuple):
    """Part of an image, in pixels from its top left corner; ``right`` and ``bottom`` are the first that do
    not belong to it."""

    left: int
    top: int
    right: int
    bottom: int

    @staticmethod
    def of_image(model: CameraModel) -> Region:
        """The whole image."""
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
