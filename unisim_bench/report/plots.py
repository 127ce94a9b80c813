"""Metrics as images. Needs matplotlib, which the extra `bench` brings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from io import BytesIO
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from .metrics import FRONT, front_of

PlotRow = dict[str, Any]
Draw = Callable[[Axes, dict[str, Any]], None]
DPI = 110
STYLES = {"compiled": ("o", "tab:blue"), "gpu": ("D", "tab:green"), "torch": ("s", "tab:red")}
"""Marks and colours by tracer."""
LEAST = {"delta_e": 1e-3, "median_mm": 1e-3, "p90_mm": 1e-2, "p99_mm": 1e-2}
"""An error of nothing has no place on an axis of logarithms: it is drawn here."""
OFFSETS = [(8, 3), (8, -11), (-8, 3), (-8, -11), *((x, y) for x in (10, -10) for y in (16, -24, 28, -36, 40, -48))]
"""Where a point's label may stand, in points from it: the first that covers no other label."""
ERRORS = {
    "delta_e": "mean ΔE to the truth",
    "median_mm": "median depth error, mm",
    "p90_mm": "90th percentile, mm",
    "p99_mm": "99th percentile, mm",
}


def images(metrics: dict[str, list[dict[str, Any]]]) -> dict[str, bytes]:
    """PNG files by their names, of what there are metrics for."""
    plots = {}
    with matplotlib.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        cameras = [case for case in metrics.get("camera", []) if any(_known(row, "delta_e") for row in case["entries"])]
        if cameras:
            titles = [f"{case['sensor']}, {case['width']}×{case['height']}" for case in cameras]
            plots["camera.png"] = _against_time(
                list(zip(cameras, titles, ("delta_e",) * len(cameras), strict=True)), "image"
            )
        for case in metrics.get("lidar", []):
            if any(_known(row, FRONT["lidar"]) for row in case["entries"]):
                names = ("median_mm", "p90_mm", "p99_mm")
                title = f"{case['sensor']}, {case['beams']}×{case['columns']}"
                plots["lidar.png"] = _against_time([(case, title, name) for name in names], "sweep")
        panels = [(kind, draw) for kind, draw in GROWTH.items() if metrics.get(kind) and metrics[kind][0]["entries"]]
        if panels:
            plots["growth.png"] = _growth(metrics, panels)
    return plots


def _png(figure: Figure) -> bytes:
    file = BytesIO()
    figure.savefig(file, format="png", dpi=DPI)
    return file.getvalue()


def _known(row: PlotRow, error: str) -> bool:
    return math.isfinite(row.get(error, math.nan))


def _against_time(panels: list[tuple[dict[str, Any], str, str]], what: str) -> bytes:
    """Panels (case, title, error's name) side by side: seconds against error, both by their logarithms."""
    figure = Figure(figsize=(5.6 * len(panels), 4.6), layout="constrained")
    for i, (case, title, error) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), i + 1)
        axes.set(xscale="log", yscale="log", xlabel=f"seconds a {what}", ylabel=ERRORS[error], title=title)
        axes.grid(True, which="both", alpha=0.2)
        axes.margins(0.2, 0.15)
        drawn = [
            (row["seconds"], max(row[error], LEAST[error]), row, bool(front))
            for row, front in zip(case["entries"], front_of(case, error), strict=True)
            if _known(row, error)
        ]
        front = sorted((x, y) for x, y, _, best in drawn if best)
        # stairs: what is up and right of them is beaten
        axes.step(
            *zip(*front, strict=True),
            where="post",
            color="0.5",
            linewidth=1,
            linestyle="--",
            label="Pareto front, filled",
        )
        axes.legend(loc="upper right", frameon=False)
        for x, y, row, best in drawn:
            style, colour = STYLES[row["tracer"]]
            axes.plot(x, y, style, color=colour, markersize=7, markerfacecolor=None if best else "white")
        # room for labels on the right
        left, right = axes.get_xlim()
        axes.set_xlim(left, right * (right / left) ** 0.12)
        figure.draw_without_rendering()
        _label(axes, [(x, y, row["method"]) for x, y, row, _ in drawn])
    return _png(figure)


def _label(axes: Axes, points: list[tuple[float, float, str]]) -> None:
    """Write each point's name beside it, where it covers no other name and no point, as far as there
    is such a place."""
    dots = [tuple(axes.transData.transform((x, y))) for x, y, _ in points]
    taken: list[Bbox] = []
    for x, y, name in points:
        for offset in OFFSETS:
            side = "left" if offset[0] > 0 else "right"
            text = axes.annotate(name, (x, y), xytext=offset, textcoords="offset points", fontsize=7.5, ha=side)
            text.set_in_layout(False)
            box = text.get_window_extent()
            inside = axes.bbox.containsx(box.x0) and axes.bbox.containsx(box.x1) and axes.bbox.containsy(box.y0)
            if inside and not any(map(box.overlaps, taken)) and not any(box.padded(3).contains(*dot) for dot in dots):
                break
            if offset != OFFSETS[-1]:
                text.remove()
        taken.append(box)
        if offset not in OFFSETS[:4]:
            line = {"arrowstyle": "-", "linewidth": 0.5, "color": "0.5", "shrinkA": 0, "shrinkB": 3}
            axes.annotate("", (x, y), xytext=(offset[0], offset[1] + 3), textcoords="offset points", arrowprops=line)


def _growth(metrics: dict[str, list[dict[str, Any]]], panels: Sequence[tuple[str, Draw]]) -> bytes:
    figure = Figure(figsize=(5.2 * len(panels), 4.2), layout="constrained")
    for i, (kind, draw) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), i + 1)
        axes.grid(True, which="both", alpha=0.2)
        draw(axes, metrics[kind][0])
        axes.set_ylim(bottom=0)
        axes.set_ylabel("seconds")
    return _png(figure)


def _line(axes: Axes, x: list[float], rows: list[PlotRow], **style: Any) -> None:
    axes.plot(x, [row["seconds"] for row in rows], "o-", markersize=5, **style)


def _pixels(axes: Axes, case: dict[str, Any]) -> None:
    _line(axes, [row["width"] * row["height"] / 1e6 for row in case["entries"]], case["entries"])
    axes.set(xlabel="million pixels", title="Pixels")


def _copies(axes: Axes, case: dict[str, Any]) -> None:
    none = [row for row in case["entries"] if not row["copies"]]
    for behind, label in ((False, "in view"), (True, "behind")):
        rows = none + [row for row in case["entries"] if row["copies"] and row["behind"] == behind]
        _line(axes, [row["copies"] for row in rows], rows, label=label)
    axes.legend(frameon=False)
    axes.set(xlabel="added actors", title=f"Actors, image {case['width']} wide")


def _region(axes: Axes, case: dict[str, Any]) -> None:
    _line(axes, [100 * row["share"] for row in case["entries"]], case["entries"], label="region alone")
    axes.axhline(case["whole_s"], color="0.4", linestyle="--", linewidth=1, label="whole frame")
    axes.legend(frameon=False)
    axes.set(xlabel="share of the frame, %", title=f"A region rendered alone, {case['width']}×{case['height']}")


def _scenes(axes: Axes, case: dict[str, Any]) -> None:
    for sensor in ("camera", "lidar"):
        rows = sorted(
            (row for row in case["entries"] if row["sensor"] == sensor), key=lambda row: float(row["weights_bytes"])
        )
        if rows:
            _line(axes, [row["weights_bytes"] / 1e6 for row in rows], rows, label=sensor)
    axes.legend(frameon=False)
    axes.set(xlabel="weights, MB", title=f"Scenes, image {case['width']} wide, and sweep")


GROWTH: dict[str, Draw] = {"pixels": _pixels, "copies": _copies, "region": _region, "scenes": _scenes}
