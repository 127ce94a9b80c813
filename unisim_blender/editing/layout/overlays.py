"""Rectangles of what is drawn over a 3D view: notices at the top, below them the legend and the speed graph, and the
presence timeline at the bottom. None is over another, or below a region or the gizmos of the view."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

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
LEAST_TIMELINE_PX, TIMELINE_HEIGHTS = 70.0, 12
"""Least height of the timeline, and how many heights are tried."""
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
        return self.right - self.left

    @property
    def height(self) -> float:
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
    sizes = {name: (scale * width, scale * height) for name, (width, height) in wanted.items()}
    gap, cut = GAP_PX * scale, GIZMOS_PX[0] * scale if gizmos else 0.0
    low, high = free.bottom + BELOW_PX * scale, free.bottom + LOWER * free.height
    corner = Rectangle(free.right - cut, free.top - GIZMOS_PX[1] * scale, free.right, free.top)
    heights = np.zeros(1)
    if "timeline" in sizes and sizes["timeline"][0] <= free.width - 2 * gap:
        share = TIMELINE if len(sizes) == 1 else LOW_TIMELINE
        most_px = min(sizes["timeline"][1], share * free.height)
        heights = np.linspace(most_px, min(most_px, LEAST_TIMELINE_PX * scale), TIMELINE_HEIGHTS)

    def placed(size: float, with_legend: bool, timeline_px: float) -> dict[str, Rectangle]:
        """Return the timeline, above it the graph at the right in a size and the legend at the left, and the legend above
        the graph where the view is not as wide as both."""
        overlays, base = {}, low
        if timeline_px:
            beside = cut if low + timeline_px > corner.bottom else 0.0
            overlays["timeline"] = Rectangle(free.left + gap, low, free.right - max(gap, beside), low + timeline_px)
            base += timeline_px + gap
        left, right = free.left + EDGE_PX * scale, free.right - EDGE_PX * scale
        if size:
            width, height = (size * edge for edge in sizes["graph"])
            right = min(right, corner.left) if base + height > corner.bottom else right
            overlays["graph"] = Rectangle(right - width, base, right, base + height)
            base = base + height + gap if left + sizes.get("legend", (0.0, 0.0))[0] + gap > right - width else base
        if with_legend:
            width, height = sizes["legend"]
            overlays["legend"] = Rectangle(left, base, left + width, base + height)
        return overlays

    def fits(box: Rectangle) -> bool:
        return box.left >= free.left and box.right <= free.right and box.top <= high and not box.meets(corner)

    legend = "legend" in sizes
    graphs = [(size, legend) for size in GRAPH_SCALES if "graph" in sizes]
    choices = [(*choice, height) for choice in (*graphs, (0.0, legend), (0.0, False)) for height in heights.tolist()]
    layouts = ((size, placed(size, with_legend, height)) for size, with_legend, height in choices)
    size, overlays = next((each for each in layouts if all(map(fits, each[1].values()))), (0.0, {}))
    over = max([free.bottom, *(box.top + gap for box in overlays.values())])
    notices = Rectangle(free.left + gap, over, free.right - max(gap, cut), free.top - TEXT_PX * scale)
    return OverlayLayout(free, notices, overlays, size * scale)
