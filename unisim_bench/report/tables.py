"""Metrics as Markdown."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from ..state_cost import STEPS

TableLine = dict[str, Any]
FigureColumn = tuple[str, Callable[[TableLine], str]]


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits and no exponent; a dash where there is none."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞"
    if value == 0:
        return "0"
    return f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"


def key(name: str, digits: int = 3, scale: float = 1.0) -> Callable[[TableLine], str]:
    """A row's value as text."""
    return lambda row: number(None if row.get(name) is None else row[name] * scale, digits)


def table_lines(columns: Sequence[FigureColumn], rows: Sequence[TableLine]) -> list[str]:
    """A table's lines."""
    head = [f"| {' | '.join(name for name, _ in columns)} |", f"|{'---|' * len(columns)}"]
    return head + [f"| {' | '.join(cell(row) for _, cell in columns)} |" for row in rows]


def _name(row: TableLine) -> str:
    return f"{'**' + row['method'] + '**' if row['front'] else row['method']}{' (scaled)' if row['scaled'] else ''}"


COMMON: list[FigureColumn] = [
    ("method", _name), ("s", key("seconds")), ("1/s", key("per_second")), ("rays/s", key("rays_per_second")),
    ("traced %", key("traced", 3, 100)), ("samples a ray", key("samples_per_ray")),
]  # fmt: skip
CAMERA: list[FigureColumn] = [*COMMON, ("PSNR dB", key("psnr_db")), ("mean ΔE", key("delta_e"))]
RECORDED: FigureColumn = ("PSNR dB to the recorded image", key("recorded_psnr_db"))
LIDAR: list[FigureColumn] = [
    *COMMON, ("median mm", key("median_mm")), ("p90 mm", key("p90_mm")), ("p99 mm", key("p99_mm")),
    ("within 2 cm %", key("within_2cm", 4, 100)), ("hits agree %", key("hits_agree", 4, 100)),
]  # fmt: skip


def markdown(document: dict[str, Any]) -> str:
    """The whole document as `run.bench_document` gives it."""
    m, metrics = document["machine"], document["metrics"]
    packages = ", ".join(f"{name} {release}" for name, release in m["packages"].items() if release)
    lines = [
        "# Run time against error", "",
        f"{m['processor']}, {m['cores']} cores, {m['system']}; {m['gpu'] and m['gpu'] + '; '}"
        f"kernels {m['variant']}; Python {m['python']}, {packages}; "
        f"commit {m['commit'] or 'unknown'}. Load when it began: {m['load']}.", "",
        f"Scene {document['scene']}. Medians of {document['settings']['rounds']} rounds in which all take turns. What is scaled "
        "was rendered in the compared windows alone, and its time multiplied by rays. In bold what nothing else beats in both "
        "time and error (mean ΔE, p90); errors nearer than the truth's uncertainty are alike. Traced is the share of rays that "
        "was not interpolated. Torch's compiler is not measured: the project does not use it.",
        *(f"Left out: {sentence}." for sentence in document["left_out"]),
    ]  # fmt: skip
    if not document["complete"]:
        lines += ["", "**The measurement was interrupted: these are the results until then.**"]
    for section, part in (("camera", _camera), ("lidar", _lidar), *GROWTH.items()):
        for case in metrics.get(section, []):
            lines += ["", *part(case)]
    return "\n".join(lines) + "\n"


def _truth(case: TableLine, names: Sequence[tuple[str, str]]) -> str:
    truth = case.get("truth")
    if truth is None:
        return "The truth was not measured."
    return "The truth's own uncertainty, beside twice its samples: " + ", ".join(
        f"{label} {number(truth[name])}" for name, label in names
    )


def _camera(case: TableLine) -> list[str]:
    recorded = [RECORDED] if any("recorded_psnr_db" in row for row in case["entries"]) else []
    return [
        f"## Camera {case['sensor']}, frame {case['frame']}, {case['width']}×{case['height']}", "",
        _truth(case, (("psnr_db", "PSNR dB"), ("delta_e", "mean ΔE"))), "",
        *table_lines([*CAMERA, *recorded], case["entries"]),
    ]  # fmt: skip


def _lidar(case: TableLine) -> list[str]:
    return [
        f"## LiDAR {case['sensor']}, frame {case['frame']}, {case['beams']}×{case['columns']}", "",
        _truth(case, (("median_mm", "median mm"), ("p90_mm", "p90 mm"), ("p99_mm", "p99 mm"))), "",
        *table_lines(LIDAR, case["entries"]),
    ]  # fmt: skip


def _pixels(case: TableLine) -> list[str]:
    columns: list[FigureColumn] = [
        ("image", lambda row: f"{row['width']}×{row['height']}"), ("s", key("seconds")),
        ("µs a pixel", lambda row: number(1e6 * row["seconds"] / (row["width"] * row["height"]))),
        ("rays", key("rays", 4)),
    ]  # fmt: skip
    return ["## Pixels", "", *table_lines(columns, case["entries"])]


def _copies(case: TableLine) -> list[str]:
    columns: list[FigureColumn] = [
        ("added actors", lambda row: str(row["copies"])),
        ("where", lambda row: "–" if not row["copies"] else "behind" if row["behind"] else "in view"),
        ("s", key("seconds")), ("samples a ray", key("samples_per_ray")),
        ("actors in view that no ray can hit", lambda row: str(row["actors_skipped"])),
    ]  # fmt: skip
    return [f"## Actors, {case['width']} wide", "", *table_lines(columns, case["entries"])]


def _size(row: TableLine) -> str:
    rows, columns = row["rows"], row["columns"]
    return f"image, {columns}×{rows}" if row["sensor"] == "camera" else f"sweep, {rows}×{columns}"


def _state(case: TableLine) -> list[str]:
    columns: list[FigureColumn] = [
        ("of", _size), ("actors", lambda row: str(row["actors"])), ("keys an actor", lambda row: str(row["keys"])),
        *((f"{name} ms", key(f"{name}_ms")) for name in STEPS), ("sum ms", key("sum_ms")),
        ("seen", lambda row: str(row["seen"])), ("in reach of rays", lambda row: str(row["in_reach"])),
    ]  # fmt: skip
    about = (
        f"Processor time before a ray is traced, compiled path, frame {case['frame']}, medians of {case['repeats']}. Copies of "
        "the scene's actors move like these; all are bound and culled, seen or not."
    )
    return ["## State of the world", "", about, "", *table_lines(columns, case["entries"])]


def _region(case: TableLine) -> list[str]:
    columns: list[FigureColumn] = [
        ("share of the frame %", key("share", 3, 100)), ("s", key("seconds")),
        ("of the whole frame's time %", key("of_whole", 3, 100)),
        ("same bits", lambda row: "yes" if row["same_bits"] else "no"),
    ]  # fmt: skip
    title = f"## A region rendered alone, {case['width']}×{case['height']}"
    return [title, "", f"The whole frame: {number(case['whole_s'])} s", "", *table_lines(columns, case["entries"])]


def _scenes(case: TableLine) -> list[str]:
    columns: list[FigureColumn] = [
        ("scene", lambda row: row["scene"]), ("sensor", lambda row: row["sensor"]),
        ("weights MB", key("weights_bytes", 3, 1e-6)),
        ("volume m³", key("volume_m3")), ("actors", lambda row: str(row["actors"])), ("s", key("seconds")),
        ("samples a ray", key("samples_per_ray")),
    ]  # fmt: skip
    return [f"## Scenes, {case['width']} wide", "", *table_lines(columns, case["entries"])]


def _loop(case: TableLine) -> list[str]:
    columns: list[FigureColumn] = [
        ("quality", lambda row: row["quality"]), ("step s", key("step_s")), ("image and sweep alone s", key("alone_s")),
        ("of alone %", key("of_alone", 3, 100)), ("vehicle, actors, drive: processor ms", key("world_ms")),
        ("mean ΔE", key("delta_e")), ("p90 mm", key("p90_mm")), ("moved actors", lambda row: str(row["actors"])),
    ]  # fmt: skip
    about = "Medians of steps that deliver both; nothing is written. Errors are those of the tables above that have this width."
    return [
        f"## A step of the closed loop, images {case['width']} wide",
        "",
        about,
        "",
        *table_lines(columns, case["entries"]),
    ]


def _memory(case: TableLine) -> list[str]:
    columns: list[FigureColumn] = [("what", lambda row: row["what"]), ("most resident memory, MB", key("peak_mb"))]
    if any(row["gpu_mb"] for row in case["entries"]):
        columns.append(("most of the GPU's, MB", lambda row: number(row["gpu_mb"]) if row["gpu_mb"] else "–"))
    return ["## Memory of a fresh process", "", *table_lines(columns, case["entries"])]


GROWTH = {
    "pixels": _pixels,
    "copies": _copies,
    "state": _state,
    "region": _region,
    "scenes": _scenes,
    "loop": _loop,
    "memory": _memory,
}
