"""Rectangles of what is drawn over a 3D view: notices at the top, below them the legend and the speed graph, and the
presence timeline at the bottom. None is over another, or below a region or the gizmos of the view."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

HORIZONTAL = ("HEADER", "TOOL_HEADER", "FOOTER", "ASSET_SHELF", "ASSET_SHELF_HEADER")
"""Regions of a 3D view that lie along its upper or lower edge; toolbar and sidebar lie along its sides."""
EDGE_PX, GAP_PX = 12.0, 8.0
"""From the view's edges, and between two overlays; this and what follows on an ordinary display."""
BELOW_PX, TEXT_PX = 36.0, 62.0
"""Heights in which Blender has the settings of the last operation, at the bottom, and its own text, at the top left."""
GIZMOS_PX = (106.0, 208.0)
"""Width and height of Blender's gizmos at the top right."""
LOWER, TIMELINE, LOW_TIMELINE = 0.68, 0.34, 0.19
"""Shares of the free height that the overlays below the notices have at most, the timeline alone, and the timeline below
others."""
LEAST_TIMELINE_PX = 70.0
GRAPH_SCALES = (1.0, 0.9, 0.8, 0.7, 0.6)
"""Sizes in which a graph is drawn; without room for the smallest, it is left out."""


@dataclass(frozen=True)
class Rectangle:
    """A part of a region, in pixels from its lower left corner."""

    left: float
    bottom: float
    right: float
    top: float

    @property
    def width(self) -> float:
        """The width."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """The height."""
        return self.top - self.bottom

    def meets(self, other: Rectangle) -> bool:
        """Return whether two rectangles have a part in common."""
        across = self.left < other.right and other.left < self.right
        return across and self.bottom < other.top and other.bottom < self.top


@dataclass(frozen=True)
class OverlayLayout:
    """The part of a view that no region covers, in it the notices' part and the rectangle of each overlay that there is
    room for, by name; and how large the graph is drawn."""

    free: Rectangle
    notices: Rectangle
    overlays: Mapping[str, Rectangle]
    graph_scale: float

    def clear(self, left: float, right: float) -> tuple[float, float]:
        """Return from what to what height no overlay lies between two places."""
        tops = [box.top for box in self.overlays.values() if box.left < right and left < box.right]
        return max([self.free.bottom, *tops]), self.free.top


def free_part(width: float, height: float, regions: Iterable[tuple[str, Rectangle]]) -> Rectangle:
    """Return what the regions of a view, by type, leave of it."""
    left, bottom, right, top = 0.0, 0.0, width, height
    for kind, box in regions:
        if kind == "WINDOW" or kind == "HUD" or box.width <= 1 or box.height <= 1:
            continue
        if not box.meets(Rectangle(0.0, 0.0, width, height)):
            continue
        if kind in HORIZONTAL and box.bottom + box.top > height:
            top = min(top, box.bottom)
        elif kind in HORIZONTAL:
            bottom = max(bottom, box.top)
        elif box.left + box.right > width:
            right = min(right, box.left)
        else:
            left = max(left, box.right)
    return Rectangle(left, bottom, max(left, right), max(bottom, top))


def lay_out_overlays(
    free: Rectangle, scale: float, wanted: Mapping[str, tuple[float, float]], gizmos: bool = True
) -> OverlayLayout:
    """Return where the overlays are: ``wanted`` has width and height, at a scale of 1, of "timeline", "graph" and "legend" as
    far as they are shown. The timeline is as wide as the view, at least its width, and lower where there is less room; the
    graph is smaller then, or left out, and then the legend. ``gizmos``: whether Blender draws its own at the top right."""
    low, high = free.bottom + BELOW_PX * scale, free.bottom + LOWER * free.height
    gap, cut = GAP_PX * scale, GIZMOS_PX[0] * scale if gizmos else 0.0
    corner = Rectangle(free.right - cut, free.top - GIZMOS_PX[1] * scale, free.right, free.top)
    if wanted.get("timeline", (0.0, 0.0))[0] * scale > free.width - 2 * gap:
        wanted = {name: size for name, size in wanted.items() if name != "timeline"}
    most_px = min(
        wanted.get("timeline", (0.0, 0.0))[1] * scale,
        (TIMELINE if set(wanted) <= {"timeline"} else LOW_TIMELINE) * free.height,
    )
    least_px = min(most_px, LEAST_TIMELINE_PX * scale)
    overlays: dict[str, Rectangle] = {}
    sizes = [(size, "legend" in wanted) for size in GRAPH_SCALES if "graph" in wanted]
    for size, with_legend in (*sizes, (0.0, "legend" in wanted), (0.0, False)):
        base = low + (least_px + gap if least_px else 0.0)
        top = max(
            [base - gap, *(box.top for box in corners(free, base, scale, wanted, size, with_legend, cut).values())]
        )
        more = max(0.0, min(most_px - least_px, high - top))
        overlays = corners(free, base + more, scale, wanted, size, with_legend, cut)
        if least_px:
            beside = cut if low + least_px + more > corner.bottom else 0.0
            overlays["timeline"] = Rectangle(free.left + gap, low, free.right - max(gap, beside), low + least_px + more)
        boxes = overlays.values()
        if all(box.left >= free.left and box.right <= free.right and box.top <= high for box in boxes) and not any(
            box.meets(corner) for box in boxes
        ):
            break
        overlays = {}
    tops = [box.top + gap for box in overlays.values()]
    text_top = free.top - TEXT_PX * scale
    notices = Rectangle(free.left + gap, max([free.bottom, *tops]), free.right - max(gap, cut), text_top)
    return OverlayLayout(free, notices, overlays, size * scale)


def corners(
    free: Rectangle,
    low: float,
    scale: float,
    wanted: Mapping[str, tuple[float, float]],
    size: float,
    with_legend: bool,
    cut: float,
) -> dict[str, Rectangle]:
    """Return where graph and legend are above ``low``, at the right and at the left, and the legend above the graph where
    both are not as wide as the view. ``size`` is the graph's, 0 for none; ``cut`` the width of Blender's gizmos."""
    placed = {}
    left, right = free.left + EDGE_PX * scale, free.right - EDGE_PX * scale
    if size:
        width, height = (size * scale * edge for edge in wanted["graph"])
        if low + height > free.top - GIZMOS_PX[1] * scale:
            right = min(right, free.right - cut)
        placed["graph"] = Rectangle(right - width, low, right, low + height)
    if with_legend:
        width, height = (scale * edge for edge in wanted["legend"])
        over = "graph" in placed and left + width + GAP_PX * scale > placed["graph"].left
        bottom = placed["graph"].top + GAP_PX * scale if over else low
        placed["legend"] = Rectangle(left, bottom, left + width, bottom + height)
    return placed
