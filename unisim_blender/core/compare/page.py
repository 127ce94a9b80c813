"""The comparison's page: its tables, and the methods' images side by side, in any browser, without a network."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from ..evaluate.report import STYLE, figure_html, page_html
from .measure import image_path, shown_frames
from .parts import REPLAY, Part
from .table import Table, cells_of

_STYLE = STYLE + "\n.best { color: #8fd18f; font-weight: bold; } figure img { max-width: 30vw; }"


def page(
    out: Path,
    title: str,
    about: str,
    tables: list[Table],
    rows: dict[str, dict[str, Any]],
    parts: list[Part],
    cameras: tuple[str, ...],
) -> str:
    """The page's text; its images are files below ``out``."""
    body = [f"<h1>{escape(title)}</h1><p>{escape(about)}</p>"]
    body += [_table(table, rows) for table in tables]
    for part in parts:
        for frame in shown_frames(part):
            for camera in cameras:
                metrics = "".join(_metrics(out, part, frame, camera, rows))
                if metrics:
                    body.append(f"<h2>{escape(part.name)}: {escape(camera)} {frame}</h2>{metrics}")
    return page_html(title, body, _STYLE)


def _table(table: Table, rows: dict[str, dict[str, Any]]) -> str:
    headings, cells = cells_of(table, rows)
    if not headings:
        return ""
    head = "".join(f"<th>{escape(text)}</th>" for text in ("", *headings))
    body = ""
    for name, row in rows.items():
        printed = "".join(f"<td{' class=best' if cell.best else ''}>{escape(cell.text)}</td>" for cell in cells[name])
        body += f"<tr><td>{escape(row['title'])}</td>{printed}</tr>"
    return f"<h2>{escape(table.title)}</h2><table><tr>{head}</tr>{body}</table>"


def _metrics(out: Path, part: Part, frame: int, camera: str, rows: dict[str, dict[str, Any]]) -> Iterator[str]:
    """The truth, every method's image, and under them how far each is from the truth."""
    truth = image_path(out, part.name, frame, camera, "truth")
    if truth.is_file():
        yield _figure(out, truth, "recorded" if part.name == REPLAY else "truth")
    for suffix in ("", "-difference"):
        for name, row in rows.items():
            path = image_path(out, part.name, frame, camera, name + suffix)
            if path.is_file():
                value = row.get(part.name, {}).get("psnr_db", {}).get(str(frame), {}).get(camera)
                found = "" if value is None or suffix else f", {value:.2f} dB"
                yield _figure(out, path, f"{row['title']}{' beside the truth' if suffix else ''}{found}")
        yield "<br>"


def _figure(out: Path, path: Path, caption: str) -> str:
    return figure_html(path.relative_to(out).as_posix(), caption)
