"""Colours of LiDAR points and their legend: one colour for a sweep, or by what was measured.

Scales hold for all sweeps that are shown together, so recorded and simulated colours can be compared. All colours here
are sRGB.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...core.colour import srgb_from_linear
from ...core.geometry import FloatArray
from ..sensors.sweeps import (
    DROPS,
    RECORDED,
    SIMULATED,
    STRAY_M,
    BeamRanges,
    ViewedSweep,
    beam_ranges,
    range_differences,
    returns_alone,
    returns_in_the_other,
    stray_points,
    sweep_metrics,
)
from ..texts import Text
from .chart import ticks
from .shapes import OverlayShapes, class_colour
from .speed_graph import INK, PAPER

RGB = tuple[float, float, float]
SWEEP_COLOURS: dict[str, RGB] = {RECORDED: (1.0, 0.85, 0.2), SIMULATED: (0.2, 0.8, 1.0)}
"""Of a sweep by its kind, where all of its points have one colour, and of returns and drops that only it has."""
KINDS = {RECORDED: Text("recorded"), SIMULATED: Text("simulated")}
GREY = (0.55, 0.55, 0.55)
"""Of what is no actor, or was not measured."""
FAINT = 0.35
"""Opacity of drops that both sweeps have, or that are shown of one alone."""
ENDS, DIFFERENT = (2.0, 98.0), 90.0
"""Percentiles of the shown values at the ends of a scale, before it is rounded outward; of absolute differences."""
VIRIDIS = (
    (0.229, 0.322, 0.546), (0.164, 0.471, 0.558), (0.128, 0.647, 0.523), (0.369, 0.789, 0.383), (0.993, 0.906, 0.144)
)  # fmt: skip
"""At even steps, as the other maps, without the map's dark end."""
TURBO = (
    (0.256, 0.382, 0.826), (0.240, 0.600, 0.990), (0.100, 0.808, 0.827), (0.192, 0.947, 0.582), (0.522, 0.999, 0.302),
    (0.794, 0.909, 0.210), (0.974, 0.700, 0.221), (0.981, 0.435, 0.114), (0.862, 0.200, 0.026), (0.626, 0.054, 0.003)
)  # fmt: skip
"""Mikhailov (2019), without its ends, which are too dark to be seen against the view."""
DIVERGING = (
    (0.16, 0.34, 0.95), (0.55, 0.68, 0.97), (0.95, 0.95, 0.95), (0.97, 0.62, 0.48), (0.88, 0.16, 0.10)
)  # fmt: skip
"""Blue, white, red: colour-blind people can tell its ends apart."""


MOST = Text("Scale: {low:g}nd to {high:g}th percentile, rounded", low=ENDS[0], high=ENDS[1])
LEAST = Text("Scale: {share:g}th percentile of absolute differences, rounded", share=DIFFERENT)
COLOURINGS: dict[str, tuple[Text, Sequence[RGB], tuple[Text, ...]]] = {
    "ONE": (Text("LiDAR points"), (), ()),
    "INTENSITY": (Text("Intensity"), VIRIDIS, (MOST,)),
    "DEPTH": (Text("Range (m)"), TURBO, (MOST,)),
    "RING": (Text("Ring (0: highest beam)"), VIRIDIS, ()),
    "INSTANCE": (Text("Actors by class"), (), ()),
    "DIFFERENCE": (Text("Recorded minus simulated range (m)"), DIVERGING, (LEAST,)),
}
"""By what colours points: the legend's title, a map where there is one, and what the map's ends are."""
SHADES = (1.0, 0.55, 1.6, 0.75, 1.3)
"""Factors of a class's colour, by which actors of one class differ; above 1, the rest is white."""
MOST_CLASSES = 8
PointColours = NDArray[np.float32]


@dataclass(frozen=True)
class PointLegend:
    """What colours mean: a title, a map from ``low`` to ``high`` or None, colours with a text each, and lines of text."""

    title: Text
    bar: tuple[Sequence[RGB], float, float] | None
    entries: tuple[tuple[RGB, str], ...]
    lines: tuple[Text, ...]


def coloured(sweeps: Sequence[ViewedSweep], by: str) -> tuple[list[PointColours], PointLegend]:
    """Return the colours (N, 4) of each sweep's points, by ONE, INTENSITY, DEPTH, RING, INSTANCE or DIFFERENCE, and their
    legend. Points without what is asked for are grey."""
    ranges, bar, (title, colour_map, ends) = beam_ranges(sweeps), None, COLOURINGS[by]
    returns = [sweep for sweep in sweeps if sweep.kind in SWEEP_COLOURS]
    if colour_map:
        values = np.concatenate([np.zeros(0), *(values_by(sweep, by, ranges) for sweep in returns)])
        bar = (colour_map, *scale_ends(values[np.isfinite(values)], by))
        entries = one_sided(returns, ranges) if by == "DIFFERENCE" else []
    elif by == "INSTANCE":
        entries = [*classes_of(returns), (GREY, Text("no actor"))]
    else:
        shown = {sweep.kind for sweep in returns}
        entries = [(SWEEP_COLOURS[kind], KINDS[kind]) for kind in SWEEP_COLOURS if kind in shown]

    def colours_of(sweep: ViewedSweep) -> PointColours:
        if sweep.kind not in SWEEP_COLOURS:
            return drop_colours(sweep, ranges)
        rgb = actor_colours(sweep) if by == "INSTANCE" else np.tile(SWEEP_COLOURS[sweep.kind], (len(sweep.points), 1))
        if bar is not None:
            rgb = map_colours(bar[0], (values_by(sweep, by, ranges) - bar[1]) / (bar[2] - bar[1]))
        if by == "DIFFERENCE":
            rgb[returns_alone(sweep, ranges)] = SWEEP_COLOURS[sweep.kind]
        return np.concatenate([rgb, np.ones((len(rgb), 1))], -1).astype(np.float32)

    legend = PointLegend(title, bar, tuple(entries), (*ends, *summary(returns, ranges)))
    return [colours_of(sweep) for sweep in sweeps], legend


def one_sided(sweeps: Sequence[ViewedSweep], ranges: Mapping[str, BeamRanges]) -> list[tuple[RGB, str]]:
    """Return entries that count the beams that return in one sweep alone."""
    words = {RECORDED: "Only recorded: {count}", SIMULATED: "Only simulated: {count}"}
    entries: list[tuple[RGB, str]] = []
    for kind, text in words.items() if ranges else ():
        count = sum(int(returns_alone(sweep, ranges).sum()) for sweep in sweeps if sweep.kind == kind)
        entries.append((SWEEP_COLOURS[kind], Text(text, count=count)))
    return [*entries, (GREY, Text("not compared"))]


def drop_colours(sweep: ViewedSweep, ranges: Mapping[str, BeamRanges]) -> PointColours:
    """Return the colours (N, 4) of beams that did not return: opaque where the other sweep has a return, else faint, and
    grey where both are shown."""
    colour = SWEEP_COLOURS[next(kind for kind, drops in DROPS.items() if drops == sweep.kind)]
    faint = GREY if sweep.lidar in ranges else colour
    differs = returns_in_the_other(sweep, ranges)
    return np.where(differs[:, None], (*colour, 1.0), (*faint, FAINT)).astype(np.float32)


def values_by(sweep: ViewedSweep, by: str, ranges: Mapping[str, BeamRanges]) -> FloatArray:
    """Return what colours a sweep's points (N,), NaN where there is nothing."""
    if by == "DIFFERENCE":
        return range_differences(sweep, ranges)
    values = sweep.attributes.get(by.lower(), np.full(len(sweep.points), np.nan)).astype(float)
    return np.where(values < 0, np.nan, values) if by == "RING" else values


def scale_ends(values: FloatArray, by: str) -> tuple[float, float]:
    """Return the values at the ends of a scale of values (N,): all rings, else robust ones, rounded outward."""
    if not len(values):
        return (-1.0, 1.0) if by == "DIFFERENCE" else (0.0, 1.0)
    if by == "RING":
        return 0.0, max(float(values.max()), 1.0)
    if by == "DIFFERENCE":
        end = max(float(np.percentile(np.abs(values), DIFFERENT)), 0.01)
        power = 10.0 ** np.floor(np.log10(end))
        end = float(f"{next(power * step for step in (1, 2, 5, 10) if power * step >= end * (1 - 1e-9)):.3g}")
        return -end, end
    low, high = (float(end) for end in np.percentile(values, ENDS))
    marks = ticks(low, max(high, low + 1e-3))
    step = marks[1] - marks[0]
    low, high = marks[0] - step * (marks[0] > low), marks[-1] + step * (marks[-1] < high)
    return float(f"{max(low, 0.0):.6g}"), float(f"{high:.6g}")


def map_colours(colours: Sequence[RGB], share: FloatArray) -> FloatArray:
    """Return the colours (N, 3) of a map at shares (N,) of its length, grey where they are NaN."""
    steps = np.linspace(0, 1, len(colours))
    rgb = np.stack([np.interp(np.nan_to_num(share), steps, column) for column in np.transpose(colours)], -1)
    return np.where(np.isfinite(share)[:, None], rgb, GREY)


def actor_colours(sweep: ViewedSweep) -> FloatArray:
    """Return colours (N, 3) by the class of each point's actor, in a shade of its own; grey off the actors."""
    if "class" not in sweep.attributes:
        return np.tile(GREY, (len(sweep.points), 1))
    table = np.array([GREY, *(point_colour(label) for label in sweep.classes)])
    shade = np.array(SHADES)[sweep.attributes["instance"].astype(int) % len(SHADES), None]
    label = sweep.attributes["class"].astype(int)
    rgb = table[label] * np.minimum(shade, 1)
    return np.where(label[:, None] > 0, rgb + (1 - rgb) * np.maximum(shade - 1, 0), GREY)


def point_colour(label: str) -> RGB:
    """Return the colour of a class's points."""
    red, green, blue = srgb_from_linear(np.array(class_colour(label), np.float32)).tolist()
    return red, green, blue


def classes_of(sweeps: Sequence[ViewedSweep]) -> list[tuple[RGB, str]]:
    """Return the classes that most points are of, each with its colour and how many actors of it the sweeps hit."""
    points: Counter[str] = Counter()
    hit: dict[str, set[int]] = {}
    for sweep in sweeps:
        numbers = sweep.attributes.get("class", np.zeros(0)).astype(int)
        for at in np.unique(numbers[numbers > 0]):
            own = numbers == at
            points[sweep.classes[at - 1]] += int(own.sum())
            hit.setdefault(sweep.classes[at - 1], set()).update(sweep.attributes["instance"][own].tolist())
    common = points.most_common(MOST_CLASSES)
    return [(point_colour(label), f"{label}: {len(hit[label])}") for label, _ in common]


def summary(sweeps: Sequence[ViewedSweep], ranges: Mapping[str, BeamRanges]) -> tuple[Text, ...]:
    """Return how many points there are, and how far the sweeps are apart, as `unisim eval` counts it."""
    counts = {kind: sum(len(sweep.points) for sweep in sweeps if sweep.kind == kind) for kind in SWEEP_COLOURS}
    shown = {sweep.kind for sweep in sweeps}
    if len(shown) < 2:
        return tuple(Text("Points: {count} {kind}", count=counts[kind], kind=KINDS[kind]) for kind in shown)
    points = Text("Points: {recorded} recorded, {simulated} simulated", **counts)
    if len({sweep.frame for sweep in sweeps if len(sweep.points)}) > 1:
        return points, Text("Not compared: the points are of two frames")
    metrics = sweep_metrics(ranges)
    if metrics is None or not np.isfinite(metrics["depth_median_m"]):
        return points, Text("Not compared: the beams are not the recorded ones")
    values = {"error": metrics["depth_median_m"], "drops": 100 * metrics["drop_accuracy"]}
    stray = {"count": stray_points(sweeps, ranges), "distance": STRAY_M}
    return (
        points,
        Text("Median range error {error:.3f} m, drops agree in {drops:.1f} % of the beams", **values),
        Text("Stray: {count} simulated points {distance:g} m or more in front of the recorded", **stray),
    )


WIDTH, ROW, MARGIN, BAR = 300, 17, 8, 10
"""Of the legend, in pixels at Blender's resolution scale 1: its width, a row's height, its margin, the bar's height."""
PIECES = 60


def legend_shapes(legend: PointLegend, text_width: Callable[[str], float]) -> tuple[OverlayShapes, float, float]:
    """Return a legend's shapes, and its width and height in pixels; ``text_width`` measures a text."""
    rows = 1 + (2 if legend.bar is not None else 0) + len(legend.entries) + len(legend.lines)
    texts = [legend.title, *(text for _, text in legend.entries), *legend.lines]
    width = max([WIDTH, *(text_width(text) + 2 * MARGIN + ROW for text in texts)])
    height, shapes = 2.0 * MARGIN + ROW * rows, OverlayShapes()
    shapes.box(0, 0, width, height, PAPER)
    y = height - MARGIN - ROW + 4
    shapes.texts.append((legend.title, MARGIN, y, INK))
    if legend.bar is not None:
        colours, low, high = legend.bar
        piece, y = (width - 2 * MARGIN) / PIECES, y - ROW
        for number, rgb in enumerate(map_colours(colours, np.linspace(0, 1, PIECES))):
            shapes.box(MARGIN + piece * number, y, piece + 0.5, BAR, (*rgb.tolist(), 1.0))
        y -= ROW
        for value in (low, (low + high) / 2, high):
            text = f"{value:+g}" if low < 0 < value else f"{value:g}"
            x = MARGIN + (value - low) / (high - low) * (width - 2 * MARGIN - text_width(text))
            shapes.texts.append((text, x, y + 3, INK))
    for rgb, text in legend.entries:
        y -= ROW
        shapes.box(MARGIN, y, BAR, BAR, (*rgb, 1.0))
        shapes.texts.append((text, MARGIN + ROW, y, INK))
    for line in legend.lines:
        y -= ROW
        shapes.texts.append((line, MARGIN, y, INK))
    return shapes, width, height
