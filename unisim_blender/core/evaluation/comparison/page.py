"""The comparison's page: its tables, and the methods' images side by side, in any browser, without a network."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from ..report import STYLE, figure_html, page_html
from .cases import REPLAY, Case
from .measure import image_path, shown_frames
from .table import ReportTable, cells_of

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
    headings, cells = cells_of(table, rows)
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
                found = "" if value is None or suffix else f", {value:.2f} dB"
                yield _figure(out, path, f"{row['title']}{' beside the truth' if suffix else ''}{found}")
        yield "<br>"


def _figure(out: Path, path: Path, caption: str) -> str:
    return figure_html(path.relative_to(out).as_posix(), caption)
