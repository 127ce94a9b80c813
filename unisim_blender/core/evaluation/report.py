"""A page of images and metrics that opens from a folder, in any browser, without a network."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from ..files import write_file
from ..output.frame_files import png_bytes
from .recorded import FrameImages

STYLE = """
body { background: #181818; color: #e6e6e6; font: 14px/1.5 sans-serif; margin: 2em; }
table { border-collapse: collapse; margin: 1em 0; }
td, th { padding: .2em .8em; text-align: right; border-bottom: 1px solid #444; }
td:first-child, th:first-child { text-align: left; } figure { display: inline-block; margin: 0 .5em .5em 0; }
figcaption { color: #bbb; } img { max-width: 46vw; image-rendering: auto; } h2 { margin-top: 2em; }
"""


class Report:
    """Collects frames' images under ``out``/images and writes ``out``/index.html."""

    def __init__(self, out: Path, title: str) -> None:
        self.out = out
        self.title = title
        self._sections: list[str] = []

    def add(self, images: FrameImages) -> None:
        """Write one frame's images. Raises `OutputError`."""
        metrics = []
        for number, row in enumerate(images.rows):
            for place, tile in enumerate(row):
                name = f"images/{images.frame:06d}_{number}_{place}.png"
                write_file(self.out / name, png_bytes(tile.pixels))
                metrics.append(figure_html(name, tile.label))
            metrics.append("<br>")
        self._sections.append(f"<h2>Frame {images.frame}</h2>\n" + "\n".join(metrics))

    def finish(self, metrics: dict[str, Any]) -> Path:
        """Write the page with a table of ``metrics``, a nested object of numbers; the page's path.
        Raises `OutputError`."""
        rows = "".join(f"<tr><td>{escape(name)}</td><td>{value}</td></tr>" for name, value in flat_metrics(metrics))
        path = self.out / "index.html"
        parts = [f"<h1>{escape(self.title)}</h1>", f"<table>{rows}</table>", *self._sections]
        write_file(path, page_html(self.title, parts).encode())
        return path


def page_html(title: str, parts: list[str], style: str = STYLE) -> str:
    """A whole page of the parts of its body."""
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{style}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>' + "\n".join(parts) + "\n</body></html>\n"


def figure_html(source: str, caption: str) -> str:
    """An image with words under it."""
    source, caption = escape(source), escape(caption)
    return f'<figure><img src="{source}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'


def flat_metrics(metrics: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Dotted names and printed values of a nested object's numbers and words; lists and missing values are left out."""
    lines = []
    for name, value in metrics.items():
        if isinstance(value, dict):
            lines += flat_metrics(value, f"{prefix}{name}.")
        elif isinstance(value, float):
            lines.append((prefix + name, f"{value:.4g}"))
        elif isinstance(value, int | str):
            lines.append((prefix + name, str(value)))
    return lines
