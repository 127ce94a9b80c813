"""The presence timeline: where it has its rows and bars, in pixels of the 3D view, what a click hits, and what is
drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.colour import srgb_from_linear
from ..actors.table import Entry, nearest_present
from ..texts import Text, counted, shortened
from .overlays import Rectangle
from .shapes import OverlayShapes, class_colour

ROW_PX, AXIS_PX, NOW_PX, NAMES_PX, EDGE_PX = 16.0, 20.0, 16.0, 150.0, 8.0
"""Heights of a row, of the axis and of the time above it, width of the names, and distance of the bars from the edge; on
an ordinary display."""
LEAST_PX = 160.0
"""A timeline with bars shorter than this is not drawn."""
SHORTEST_PX = 3.0
"""Smallest length of a bar, so that one frame is seen."""
TICKS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)
TICK_PX = 60.0


@dataclass(frozen=True)
class Timeline:
    """The rows that fit, ``rows`` from ``first`` on of ``count``; bars lie from ``start`` to ``end`` in pixels and
    stand for ``start_s`` to ``end_s`` seconds. ``bottom`` and ``top`` bound all of it, rows begin at ``rows_top``
    and go down."""

    rows: tuple[Entry, ...]
    first: int
    count: int
    left: float
    right: float
    bottom: float
    top: float
    rows_top: float
    row_px: float
    start: float
    end: float
    start_s: float
    end_s: float

    def x_of(self, time_s: float) -> float:
        """Return where a time lies."""
        return self.start + (time_s - self.start_s) / (self.end_s - self.start_s) * (self.end - self.start)

    def time_at(self, x: float) -> float:
        """Return the time at a place; the drive's first or last beyond the bars."""
        share = float(np.clip((x - self.start) / (self.end - self.start), 0.0, 1.0))
        return self.start_s + share * (self.end_s - self.start_s)

    def covers(self, x: float, y: float) -> bool:
        """Return whether a place is on the timeline."""
        return self.left <= x <= self.right and self.bottom <= y <= self.top

    def bars(self, entry: Entry) -> list[tuple[float, float]]:
        """Return from where to where an actor's bars reach."""
        bars = []
        for start_s, end_s in entry.steps:
            start, end = self.x_of(float(start_s)), self.x_of(float(end_s))
            middle = (start + end) / 2
            half = max(end - start, SHORTEST_PX) / 2
            bars.append((middle - half, middle + half))
        return bars

    def row_at(self, y: float) -> int | None:
        """Return which of the rows is at a height."""
        row = int((self.rows_top - y) // self.row_px)
        return row if 0 <= row < len(self.rows) and y <= self.rows_top else None

    def row_bottom(self, row: int) -> float:
        """Return the lower edge of a row."""
        return self.rows_top - (row + 1) * self.row_px

    def hit(self, x: float, y: float) -> tuple[Entry, float] | None:
        """Return the actor whose bar or name is at a place, and the time there; on a name, and beside the bars, the
        nearest time at which the actor is there. None beside the rows."""
        row = self.row_at(y)
        if row is None or not self.covers(x, y):
            return None
        time_s = nearest_present(self.rows[row], self.time_at(x))
        return None if time_s is None else (self.rows[row], time_s)

    def ticks(self) -> list[float]:
        """Return the times that are labelled."""
        a_second = (self.end - self.start) / (self.end_s - self.start_s)
        step = next((step for step in TICKS_S if step * a_second >= TICK_PX), TICKS_S[-1])
        first = int(np.ceil(self.start_s / step - 1e-6))
        return [number * step for number in range(first, int(np.floor(self.end_s / step + 1e-6)) + 1)]


def size_of(count: int) -> tuple[float, float]:
    """Return the least width and the height of a timeline with a number of rows, at a scale of 1."""
    return NAMES_PX + LEAST_PX + EDGE_PX, ROW_PX * max(count, 1) + AXIS_PX + NOW_PX


def fitting_rows(box: Rectangle, scale: float) -> int:
    """Return how many rows a rectangle holds."""
    return max(0, int((box.height - (AXIS_PX + NOW_PX) * scale + 1e-6) // (ROW_PX * scale)))


def lay_out(
    box: Rectangle, scale: float, entries: Sequence[Entry], scroll: int, start_s: float, end_s: float
) -> Timeline | None:
    """Return the timeline of as many entries as a rectangle holds, from row ``scroll`` on; None where it holds none."""
    fit, left, right = fitting_rows(box, scale), box.left, box.right
    start, end = left + NAMES_PX * scale, right - EDGE_PX * scale
    if fit < 1 or end - start < LEAST_PX * scale or end_s <= start_s:
        return None
    first = scrolled(scroll, 0, len(entries), fit)
    rows = tuple(entries[first : first + fit])
    bottom = box.bottom
    rows_top = bottom + max(len(rows), 1) * ROW_PX * scale
    top = rows_top + AXIS_PX * scale
    return Timeline(
        rows, first, len(entries), left, right, bottom, top, rows_top, ROW_PX * scale, start, end, start_s, end_s
    )


def scrolled(first: int, by: int, count: int, fit: int) -> int:
    """Return the first row after scrolling, kept where the last rows fill the timeline."""
    return int(np.clip(first + by, 0, max(0, count - fit)))


BACKGROUND = (0.10, 0.10, 0.10, 0.86)
EVEN_ROW = (1.0, 1.0, 1.0, 0.03)
ACTIVE_ROW = (1.0, 1.0, 1.0, 0.16)
EDITED = (1.0, 1.0, 1.0, 1.0)
NOW = (0.30, 0.55, 0.95, 1.0)
TICK = (1.0, 1.0, 1.0, 0.12)
TEXT, FAINT_TEXT = (0.92, 0.92, 0.92, 1.0), (0.62, 0.62, 0.62, 1.0)


def rows_text(timeline: Timeline) -> str:
    """Return which rows are shown."""
    if not timeline.count:
        return Text("No actor: clear the filter")
    if len(timeline.rows) == timeline.count:
        return counted(timeline.count, "1 actor", "{count} actors")
    last = timeline.first + len(timeline.rows)
    return Text("{first}–{last} of {count}", first=timeline.first + 1, last=last, count=timeline.count)


def shapes_of(
    timeline: Timeline, now_s: float, active: int | None, scale: float, text_width: Callable[[str], float]
) -> OverlayShapes:
    """Return what is drawn, in pixels of the view; ``active`` is the key of the active actor, and ``text_width`` measures
    a text."""
    shapes, (left, right) = OverlayShapes(), (timeline.left, timeline.right)
    shapes.box(left, timeline.bottom, right - left, timeline.top - timeline.bottom, BACKGROUND)
    for row, entry in enumerate(timeline.rows):
        if entry.key == active or row % 2:
            colour = ACTIVE_ROW if entry.key == active else EVEN_ROW
            shapes.box(left, timeline.row_bottom(row), right - left, timeline.row_px, colour)
    for time_s in timeline.ticks():
        x = timeline.x_of(time_s)
        shapes.box(x, timeline.bottom, 1, timeline.top - timeline.bottom, TICK)
        shapes.texts.append((f"{time_s:g}", x + 3 * scale, timeline.rows_top + 5 * scale, FAINT_TEXT))
    inset, rim = 3 * scale, 1.5 * scale
    for row, entry in enumerate(timeline.rows):
        bottom, height = timeline.row_bottom(row) + inset, timeline.row_px - 2 * inset
        for start, end in timeline.bars(entry):
            if entry.edited:
                shapes.box(start - rim, bottom - rim, end - start + 2 * rim, height + 2 * rim, EDITED)
            shapes.box(start, bottom, end - start, height, colour_of(entry))
        name = shortened(entry.name + (" *" if entry.edited else ""), timeline.start - left - 12 * scale, text_width)
        shapes.texts.append((name, left + 6 * scale, bottom + scale, TEXT if entry.there else FAINT_TEXT))
    shapes.texts.append((rows_text(timeline), left + 6 * scale, timeline.rows_top + 5 * scale, FAINT_TEXT))
    now, label = timeline.x_of(now_s), f"{now_s:.2f} s"
    shapes.box(now - scale, timeline.bottom, 2 * scale, timeline.top - timeline.bottom, NOW)
    width = text_width(label)
    x = min(now + 4 * scale, right - width - 4 * scale)
    shapes.box(x - 4 * scale, timeline.top, width + 8 * scale, NOW_PX * scale, BACKGROUND)
    shapes.texts.append((label, x, timeline.top + 4 * scale, TEXT))
    return shapes


def colour_of(entry: Entry) -> tuple[float, ...]:
    """Return the colour of an actor's bars, that of its class; darker where it is hidden in the view."""
    colour = srgb_from_linear(np.array(class_colour(entry.label), np.float32)) * (0.45 if entry.hidden else 1.0)
    return (*(float(part) for part in colour), 1.0)
