"""The speed graph as shapes in pixels: triangles with colours and lines of text. numpy alone; whoever
draws it needs a GPU."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.geometry import FloatArray
from ..motion.kinematics import QUANTITIES, MotionComparison, MotionProfile
from ..motion.retiming import instant
from ..sampled.clock import Clock
from ..texts import Text, kmh, series
from .chart import ticks
from .shapes import OverlayShapes

WIDTH, HEIGHT = 440, 214
"""Of the graph, in pixels at Blender's resolution scale 1."""
LEFT, RIGHT, TOP, BOTTOM = 132, 14, 42, 84
"""Margins round the speed's axes: numbers and values on the left, title and speed above, times and strips below."""
STRIP, STRIP_GAP = 10, 4
"""Height of a strip that says where a limit is exceeded, and the gap between two."""
DOT = 4
"""Half the edge of the dot where the curve is dragged."""
PAPER, INK, GRID = (0.06, 0.06, 0.06, 0.82), (0.85, 0.85, 0.85, 1.0), (0.32, 0.32, 0.32, 1.0)
RECORDED, EDITED, OVER, NOW = (
    (0.62, 0.62, 0.62, 1.0),
    (0.25, 0.55, 1.0, 1.0),
    (1.0, 0.16, 0.12, 1.0),
    (1.0, 0.85, 0.2, 1.0),
)
STRIPS = {"acceleration_m_s2": Text("accel."), "lateral_m_s2": Text("lateral"), "curvature_1_m": Text("curv.")}
UNITS = {"acceleration_m_s2": ("m/s²", 1), "lateral_m_s2": ("m/s²", 1), "curvature_1_m": ("1/m", 3)}
"""Units of quantities and the digits that are shown."""
KMH = 3.6


@dataclass(frozen=True)
class GraphAxes:
    """Scales of times and speeds in the graph, in pixels."""

    first_s: float
    last_s: float
    top_m_s: float

    def x(self, time_s: FloatArray) -> FloatArray:
        """Columns of times."""
        share = (np.asarray(time_s) - self.first_s) / max(self.last_s - self.first_s, 1e-9)
        return np.asarray(LEFT + share * (WIDTH - LEFT - RIGHT))

    def y(self, speed_m_s: FloatArray) -> FloatArray:
        """Rows of speeds."""
        return np.asarray(BOTTOM + np.asarray(speed_m_s) / self.top_m_s * (HEIGHT - TOP - BOTTOM))

    def time_s(self, x: float) -> float:
        """Time of a column."""
        return self.first_s + (x - LEFT) / (WIDTH - LEFT - RIGHT) * (self.last_s - self.first_s)

    def speed_m_s(self, pixels: float) -> float:
        """Difference of speeds that a number of rows is."""
        return pixels / (HEIGHT - TOP - BOTTOM) * self.top_m_s


def axes_of(graph: MotionComparison, top_m_s: float = 0.0) -> GraphAxes:
    """Return axes that hold both curves from 0 up, and ``top_m_s``."""
    speeds = np.concatenate([graph.now.speed_m_s, graph.recorded.speed_m_s if graph.recorded is not None else []])
    top = float(np.nanmax(speeds)) if np.isfinite(speeds).any() else 0.0
    return GraphAxes(float(graph.now.times_s[0]), float(graph.now.times_s[-1]), max(1.15 * top, 2.0, top_m_s))


def on_curve(graph: MotionComparison, x: float, y: float, near: float) -> float | None:
    """Return the time at which the curve of an object passes a place of the graph within ``near`` pixels; None where it
    does not."""
    axes = axes_of(graph)
    time_s = axes.time_s(x)
    if not axes.first_s <= time_s <= axes.last_s:
        return None
    return time_s if abs(float(axes.y(speed_of(graph, time_s))) - y) <= near else None


def speed_of(graph: MotionComparison, time_s: float) -> FloatArray:
    """Return an object's speed () at a time; NaN where it is not there."""
    return np.asarray(np.interp(time_s, graph.now.times_s, graph.now.speed_m_s))


def grip(
    graph: MotionComparison,
    time_s: float,
    reach_s: float,
    limit_m_s2: float,
    top_m_s: float,
    speed_m_s: float | None = None,
) -> OverlayShapes:
    """Return what shows where the curve is dragged: a dot with the speed, the curve's or a given one, how far the drag
    reaches and lines as steep as the limit of acceleration; neither where it is 0."""
    shapes, axes = OverlayShapes(), axes_of(graph, top_m_s)
    speed = float(speed_of(graph, time_s))
    x, y = float(axes.x(np.array(time_s))), float(axes.y(np.array(speed)))
    inside = np.clip(np.array([time_s - reach_s, time_s + reach_s]), axes.first_s, axes.last_s)
    for column in axes.x(inside) if reach_s else ():
        shapes.box(float(column), BOTTOM, 1, HEIGHT - TOP - BOTTOM, INK)
    for way in (-1, 1) if limit_m_s2 else ():
        run_s = np.linspace(0, reach_s / 2, 9)
        fan = np.stack([axes.x(time_s + run_s), axes.y(speed + way * limit_m_s2 * run_s)], -1)
        for side in (fan, fan * [-1, 1] + [2 * x, 0]):
            held = side[
                (side[:, 1] > BOTTOM) & (side[:, 1] < HEIGHT - TOP) & (side[:, 0] > LEFT) & (side[:, 0] < WIDTH - RIGHT)
            ]
            shapes.line(held, 1.0, [OVER] * max(len(held) - 1, 0))
    shapes.box(x - DOT, y - DOT, 2 * DOT, 2 * DOT, NOW)
    shapes.texts.append((kmh(speed if speed_m_s is None else speed_m_s), min(x + 8, WIDTH - 64), y + 6, NOW))
    return shapes


def curves(graph: MotionComparison, top_m_s: float = 0.0) -> OverlayShapes:
    """Return what changes with the motion alone: axes, curves, and strips that are red where a limit is exceeded."""
    shapes, axes = OverlayShapes(), axes_of(graph, top_m_s)
    shapes.box(0, 0, WIDTH, HEIGHT, PAPER)
    right, times = WIDTH - RIGHT, graph.now.times_s
    for speed in ticks(0.0, axes.top_m_s * KMH):
        row = float(axes.y(np.array(speed / KMH)))
        shapes.box(LEFT, row, right - LEFT, 1, GRID)
        shapes.texts.append((f"{speed:g}", LEFT - 30, row - 4, INK))
    shapes.texts.append(("km/h", LEFT - 64, BOTTOM + 36, INK))
    for time in ticks(axes.first_s, axes.last_s):
        column = float(axes.x(np.array(time)))
        shapes.box(column, BOTTOM - 4, 1, 4, INK)
        shapes.texts.append((f"{time:g} s", column - 6, BOTTOM - 18, INK))
    shapes.box(LEFT, BOTTOM, right - LEFT, 1, INK)

    def points(motion: MotionProfile) -> FloatArray:
        return np.stack([axes.x(times), axes.y(motion.speed_m_s)], -1)

    if graph.recorded is not None:
        shapes.line(points(graph.recorded), 2.0, [RECORDED] * (len(times) - 1))
    over = graph.anywhere
    if graph.is_edited:
        pieces = [OVER if a or b else EDITED for a, b in zip(over[:-1], over[1:], strict=True)]
        shapes.line(points(graph.now), 2.5, pieces)
    edges = axes.x(np.concatenate([times[:1], (times[1:] + times[:-1]) / 2, times[-1:]]))
    for i, name in enumerate(QUANTITIES):
        low = low_of_strip(i)
        shapes.box(LEFT, low, right - LEFT, STRIP, GRID)
        for at in np.flatnonzero(graph.exceeded[name]):
            shapes.box(float(edges[at]), low, max(float(edges[at + 1] - edges[at]), 2.0), STRIP, OVER)
    return shapes


def low_of_strip(i: int) -> float:
    """Return the lower edge of the strip of a quantity, by its number."""
    return float(BOTTOM - 28 - (i + 1) * STRIP - i * STRIP_GAP)


def moment(graph: MotionComparison, frame: float, top_m_s: float = 0.0) -> OverlayShapes:
    """Return what changes with the frame that is shown: its line, and the values there."""
    shapes, axes = OverlayShapes(), axes_of(graph, top_m_s)
    time_s = float(np.interp(frame, graph.frames, graph.now.times_s))
    column = float(axes.x(np.array(time_s)))
    low = low_of_strip(len(QUANTITIES) - 1)
    shapes.box(column - 0.75, low, 1.5, HEIGHT - TOP - low, NOW)
    what = Text("edited blue" if graph.is_edited else "as recorded")
    if graph.is_edited and graph.recorded is not None:
        what = Text("edited blue, recorded grey")
    shapes.texts.append((series([graph.name, what], ": "), 6, HEIGHT - 15, INK))
    (time, _), (speed, _), *over = values(graph, frame)
    shapes.texts.append((series([time, speed], ": "), 6, HEIGHT - 32, INK))
    for i, name in enumerate(QUANTITIES):
        text, is_over = over[i] if over else ("", False)
        shapes.texts.append((series([STRIPS[name], text], " "), 6, low_of_strip(i) + 1, OVER if is_over else INK))
    return shapes


def values(graph: MotionComparison, frame: float) -> list[tuple[str, bool]]:
    """Return the values at a frame as texts, and whether each is over its limit: time, speed,
    accelerations and curvature."""
    now = graph.now
    clock = Clock(graph.frames, now.times_s)
    at, time = clock.index(frame), instant(float(clock.time_s(np.array(frame))), clock)
    if not graph.frames[0] <= frame < graph.frames[-1] + 1:
        return [(time, False), (Text("outside the drive"), False)]
    speed = now.speed_m_s[at]
    if not np.isfinite(speed):
        return [(time, False), (Text("not present"), False)]
    rows = [(time, False), (kmh(float(speed)), False)]
    for name, (unit, digits) in UNITS.items():
        value = round(float(getattr(now, name)[at]), digits) + 0.0  # no minus before a zero
        text = f"{value:+.{digits}f}" if np.isfinite(value) else "–"
        rows.append((f"{text} {unit}", bool(graph.exceeded[name][at])))
    return rows
