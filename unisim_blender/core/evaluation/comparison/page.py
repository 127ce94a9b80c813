"""The comparison's tables in Markdown, and its page: the tables and the methods' images side by side, in any browser,
without a network."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from ..recorded_runs import STYLE, figure_html, page_html
from .measure import REPLAY, Case, image_path, shown_frames


@dataclass(frozen=True)
class Column:
    """A metric of a row: where it is in the row's document, and how it is printed. ``best`` picks the best one; None
    where none is better."""

    heading: str
    path: tuple[str, ...]
    form: str = "{:.2f}"
    scale: float = 1.0
    best: Callable[[list[float]], float] | None = max

    def value(self, row: dict[str, Any]) -> float | None:
        """A row's value, in the column's unit; None where the row has none."""
        value: Any = row
        for name in self.path:
            value = value.get(name) if isinstance(value, dict) else None
        return float(value) * self.scale if isinstance(value, int | float) else None


@dataclass(frozen=True)
class ReportTable:
    """Columns under one title."""

    title: str
    columns: tuple[Column, ...]


def tables_of(cases: dict[str, bool]) -> list[ReportTable]:
    """The tables for cases by name, each with whether it moves nothing but the view."""
    others = {name: view for name, view in cases.items() if name != REPLAY}
    edits = [ReportTable(f"{name}, PSNR in dB", _view(name) if view else _edit(name)) for name, view in others.items()]
    return [_replay(), *edits, _lidar(list(others)), _cost()]


def _replay() -> ReportTable:
    camera = REPLAY, "camera", "edit"
    return ReportTable(
        "Replay, frames that nobody learnt from",
        (
            Column("PSNR dB", (*camera, "psnr_db")),
            Column("SSIM", (*camera, "ssim"), "{:.3f}"),
            Column("LPIPS", (*camera, "lpips"), "{:.3f}", best=min),
            Column("FID", (REPLAY, "fid"), "{:.1f}", best=min),
            Column("PSNR driving", (*camera, "driving", "psnr_db")),
            Column("PSNR in actors' boxes", (*camera, "actors", "psnr_db")),
        ),
    )


def _view(name: str) -> tuple[Column, ...]:
    camera = name, "camera", "edit"
    return (
        Column("frame", (*camera, "psnr_db")),
        Column("cost", (name, "camera", "edit_costs_db", "frame"), best=None),
        Column("SSIM", (*camera, "ssim"), "{:.3f}"),
        Column("LPIPS", (*camera, "lpips"), "{:.3f}", best=min),
        Column("FID", (name, "fid"), "{:.1f}", best=min),
        Column("seen", (*camera, "frame_seen", "psnr_db")),
        Column("never seen", (*camera, "frame_never_seen", "psnr_db")),
    )


def _edit(name: str) -> tuple[Column, ...]:
    camera = name, "camera", "edit"
    return (
        Column("frame", (*camera, "psnr_db")),
        Column("cost", (name, "camera", "edit_costs_db", "frame"), best=None),
        Column("inside", (*camera, "edited", "psnr_db")),
        Column("less shadow", (*camera, "edited_without_shadow", "psnr_db")),
        Column("cost inside", (name, "camera", "edit_costs_db", "edited"), best=None),
        Column("outside", (*camera, "outside_edit", "psnr_db")),
    )


def _lidar(edits: list[str]) -> ReportTable:
    lidar = REPLAY, "lidar", "edit"
    return ReportTable(
        "LiDAR",
        (
            Column("median cm", (*lidar, "depth_median_m"), "{:.2f}", 100, min),
            Column("p90 cm", (*lidar, "depth_p90_m"), "{:.1f}", 100, min),
            Column("hit rate %", (*lidar, "hit_rate"), "{:.1f}", 100),
            Column("drop accuracy %", (*lidar, "drop_accuracy"), "{:.1f}", 100),
            Column("intensity RMSE", (*lidar, "intensity_rmse"), "{:.3f}", best=min),
            Column("Chamfer cm", (*lidar, "chamfer_m"), "{:.1f}", 100, min),
            *(
                Column(f"{name}: median cm", (name, "lidar", "edit", "depth_median_m"), "{:.2f}", 100, min)
                for name in edits
            ),
        ),
    )


def _cost() -> ReportTable:
    return ReportTable(
        "Time, and boxes",
        (
            Column("making, minutes", ("made", "training_s"), "{:.1f}", 1 / 60, best=None),
            Column("steps", ("made", "iterations"), "{:.0f}", best=None),
            Column("s a frame", (REPLAY, "seconds", "camera"), "{:.3f}", best=min),
            Column("s a sweep", (REPLAY, "seconds", "lidar"), "{:.3f}", best=min),
            Column("shift taken back %", ("tracklets", "shift_taken_back"), "{:.0f}", 100),
            Column("turn taken back %", ("tracklets", "turn_taken_back"), "{:.0f}", 100),
        ),
    )


@dataclass(frozen=True)
class Cell:
    """Cell of a printed table: its text, and whether it is the column's best."""

    text: str
    best: bool = False


def table_cells(table: ReportTable, rows: dict[str, dict[str, Any]]) -> tuple[list[str], dict[str, list[Cell]]]:
    """The headings of the columns in which any row has a value, and each row's cells."""
    columns = [column for column in table.columns if any(column.value(row) is not None for row in rows.values())]
    cells: dict[str, list[Cell]] = {name: [] for name in rows}
    for column in columns:
        values = {name: column.value(row) for name, row in rows.items()}
        there = [value for value in values.values() if value is not None]
        best = None if column.best is None or len(there) < 2 else column.form.format(column.best(there))
        for name, value in values.items():
            text = "" if value is None else column.form.format(value)
            cells[name].append(Cell(text, best is not None and text == best))
    return [column.heading for column in columns], cells


def comparison_markdown(title: str, about: str, tables: list[ReportTable], rows: dict[str, dict[str, Any]]) -> str:
    """All tables, rows by their titles; the best of a column in bold."""
    lines = [f"# {title}", "", about, ""]
    for table in tables:
        headings, cells = table_cells(table, rows)
        if not headings:
            continue
        lines += [f"## {table.title}", "", "| | " + " | ".join(headings) + " |", "|---" + "|---:" * len(headings) + "|"]
        for name, row in rows.items():
            printed = (f"**{cell.text}**" if cell.best else cell.text for cell in cells[name])
            lines.append(f"| {row['title']} | " + " | ".join(printed) + " |")
        lines.append("")
    return "\n".join(lines)


_STYLE = STYLE + "\n.best { color: #8fd18f; font-weight: bold; } figure img { max-width: 30vw; }"


def page(
    out: Path,
    title: str,
    about: str,
    tables: list[ReportTable],
    rows: dict[str, dict[str, Any]],
    cases: list[Case],
    cameras: tuple[str, ...],
) -> str:
    """The page's text; its images are files below ``out``."""
    body = [f"<h1>{escape(title)}</h1><p>{escape(about)}</p>"]
    body += [_table(table, rows) for table in tables]
    for case in cases:
        for frame in shown_frames(case):
            for camera in cameras:
                metrics = "".join(_metrics(out, case, frame, camera, rows))
                if metrics:
                    body.append(f"<h2>{escape(case.name)}: {escape(camera)} {frame}</h2>{metrics}")
    return page_html(title, body, _STYLE)


def _table(table: ReportTable, rows: dict[str, dict[str, Any]]) -> str:
    headings, cells = table_cells(table, rows)
    if not headings:
        return ""
    head = "".join(f"<th>{escape(text)}</th>" for text in ("", *headings))
    body = ""
    for name, row in rows.items():
        printed = "".join(f"<td{' class=best' if cell.best else ''}>{escape(cell.text)}</td>" for cell in cells[name])
        body += f"<tr><td>{escape(row['title'])}</td>{printed}</tr>"
    return f"<h2>{escape(table.title)}</h2><table><tr>{head}</tr>{body}</table>"


def _metrics(out: Path, case: Case, frame: int, camera: str, rows: dict[str, dict[str, Any]]) -> Iterator[str]:
    """The truth, every method's image, and under them how far each is from the truth."""
    truth = image_path(out, case.name, frame, camera, "truth")
    if truth.is_file():
        yield _figure(out, truth, "recorded" if case.name == REPLAY else "truth")
    for suffix in ("", "-difference"):
        for name, row in rows.items():
            path = image_path(out, case.name, frame, camera, name + suffix)
            if path.is_file():
                value = row.get(case.name, {}).get("psnr_db", {}).get(str(frame), {}).get(camera)
                quality = "" if value is None or suffix else f", {value:.2f} dB"
                yield _figure(out, path, f"{row['title']}{' beside the truth' if suffix else ''}{quality}")
        yield "<br>"


def _figure(out: Path, path: Path, caption: str) -> str:
    return figure_html(path.relative_to(out).as_posix(), caption)
