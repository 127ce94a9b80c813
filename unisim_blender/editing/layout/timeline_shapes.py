"""What of the presence timeline is drawn: rectangles with their colours, and which rows are shown."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.colour import srgb_from_linear
from ..actors.filter import Entry
from ..texts import Text, counted
from .class_colours import class_colour
from .timeline import Timeline

BACKGROUND = (0.10, 0.10, 0.10, 0.86)
EVEN_ROW = (1.0, 1.0, 1.0, 0.03)
ACTIVE_ROW = (1.0, 1.0, 1.0, 0.16)
EDITED = (1.0, 1.0, 1.0, 1.0)
NOW = (0.30, 0.55, 0.95, 1.0)
TICK = (1.0, 1.0, 1.0, 0.12)


def rows_text(timeline: Timeline) -> str:
    """Return which rows are shown."""
    if not timeline.count:
        return Text("No actor: clear the filter")
    if len(timeline.rows) == timeline.count:
        return counted(timeline.count, "1 actor", "{count} actors")
    last = timeline.first + len(timeline.rows)
    return Text("{first}–{last} of {count}", first=timeline.first + 1, last=last, count=timeline.count)


def rectangles(timeline: Timeline, now_s: float, active: int | None, scale: float) -> tuple[Any, Any]:
    """Return the corners (N, 3) of the triangles that are drawn, and their colours (N, 4)."""
    found: list[tuple[float, float, float, float, tuple[float, ...]]] = []

    def rectangle(left: float, bottom: float, right: float, top: float, colour: tuple[float, ...]) -> None:
        found.append((left, bottom, right, top, colour))

    rectangle(timeline.left, timeline.bottom, timeline.right, timeline.top, BACKGROUND)
    for row, entry in enumerate(timeline.rows):
        bottom = timeline.row_bottom(row)
        if entry.key == active or row % 2:
            colour = ACTIVE_ROW if entry.key == active else EVEN_ROW
            rectangle(timeline.left, bottom, timeline.right, bottom + timeline.row_px, colour)
    for time_s in timeline.ticks():
        x = timeline.x_of(time_s)
        rectangle(x, timeline.bottom, x + 1, timeline.top, TICK)
    inset, line = 3 * scale, 1.5 * scale
    for row, entry in enumerate(timeline.rows):
        bottom = timeline.row_bottom(row)
        for left, right in timeline.bars(entry):
            if entry.edited:
                rectangle(
                    left - line, bottom + inset - line, right + line, bottom + timeline.row_px - inset + line, EDITED
                )
            rectangle(left, bottom + inset, right, bottom + timeline.row_px - inset, colour_of(entry))
    x = timeline.x_of(now_s)
    rectangle(x - scale, timeline.bottom, x + scale, timeline.top, NOW)
    corners = np.array(
        [[(a, b), (c, b), (c, d), (a, b), (c, d), (a, d)] for a, b, c, d, _ in found], np.float32
    ).reshape(-1, 2)
    colours = np.repeat(np.array([colour for *_, colour in found], np.float32), 6, 0)
    return np.column_stack([corners, np.zeros(len(corners), np.float32)]), colours


def colour_of(entry: Entry) -> tuple[float, ...]:
    """Return the colour of an actor's bars, that of its class; darker where it is hidden in the view."""
    colour = srgb_from_linear(np.array(class_colour(entry.label), np.float32)) * (0.45 if entry.hidden else 1.0)
    return (*(float(part) for part in colour), 1.0)
