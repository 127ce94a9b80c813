"""Evaluations from paths to files: metrics.json, and a page with images that opens from a folder, without a network."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ..data.log import Log
from ..data.own_vehicle import outlines_from_json
from ..errors import UnisimError
from ..files import holds_out, write_file
from ..formats.readers import open_log
from ..json_file import json_bytes
from ..model.scene_file import SceneHeader
from ..output.frame_files import png_bytes
from ..prepare.renderers import detail_of
from ..prepare.replay import aligned_log, replayed_drive
from ..prepare.selection import check_names, select_frames
from ..render.code_identity import code_identity
from ..render.renderer import Renderer
from ..scenes.recipe import load_backend
from ..scenes.scene import Scene, open_scene
from ..world.drive import Drive
from .recorded import EvaluationPlan, FrameImages, Perceptual, TimedRenderer, evaluate
from .tracklets import disturbance_taken_back

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


Progress = Callable[[Iterable[int], str], Iterable[int]]
"""Shows a loop's progress; the loop's items and what they belong to."""


@dataclass(frozen=True)
class EvaluationOptions:
    """Options of the command line; None stands for the setting that the scene was trained on."""

    frames: str | None = None
    cameras: tuple[str, ...] | None = None
    width: int | None = None
    quality: str = "balanced"
    lpips_weights: Path | None = None
    device: str = "cpu"
    detail: bool = False

    def renderer(self, scene: Scene, others: Mapping[str, Scene], log: Log) -> Renderer:
        """Return the renderer of a trained scene, with actors of others, and with the detail of a log's images if asked for."""
        backend = load_backend(scene, others, self.quality, self.device)
        return Renderer(backend, detail=detail_of(backend, scene, log) if self.detail else None)


@holds_out
def evaluate_scene(
    scene: Path, log_path: Path, out: Path, options: EvaluationOptions, progress: Progress
) -> dict[str, Any]:
    """Compare a trained scene's frames with a log's and write ``out``; the metrics without those of single frames.

    Raises `UnisimError`.
    """
    opened = open_scene(scene)
    header = opened.header
    log = aligned_log(header, open_log(log_path))
    drive = replayed_drive(header, log)
    plan = _plan(header, log.drive, options)
    renderer = TimedRenderer(options.renderer(opened, {}, log), drive)
    report = Report(out, f"{header.name} against {log.drive.name}")
    metrics = evaluate(renderer, log, plan, report.add, lambda frames: progress(frames, log.drive.name))
    if (noise := disturbance_taken_back(header, log.drive)) is not None:
        metrics["tracklets"] = noise
    about = {
        "scene": {"name": header.name, "sha256": opened.digest},
        "log": log.drive.name,
        "code": code_identity(),
        "quality": options.quality,
        "detail": options.detail,
        "width": plan.width,
        "frames": list(plan.frames),
    }
    write_file(out / "metrics.json", json_bytes({**about, **metrics}))
    summary = {name: value for name, value in metrics.items() if name != "per_frame"}
    report.finish(summary)
    return summary


@holds_out
def evaluate_split(
    logs: tuple[str, ...], scenes: Path, log_root: Path, out: Path, options: EvaluationOptions, progress: Progress
) -> dict[str, Any]:
    """Evaluate the scene in ``scenes``/NAME against the log in ``log_root``/NAME for every name; the
    logs' mean metrics.

    Raises `UnisimError`, before anything is rendered where a log or a scene is missing.
    """
    for folder in (path / name for name in logs for path in (scenes, log_root)):
        if not folder.is_dir():
            raise UnisimError(f"{folder}: is missing; the split has the logs {', '.join(logs)}")
    per_log = {name: evaluate_scene(scenes / name, log_root / name, out / name, options, progress) for name in logs}
    metrics = mean_metrics(list(per_log.values()))
    write_file(out / "metrics.json", json_bytes({**metrics, "per_log": per_log}))
    Report(out, f"{len(logs)} logs").finish({**metrics, "per_log": per_log})
    return metrics


def mean_metrics(logs: list[dict[str, Any]]) -> dict[str, Any]:
    """The mean of every metric that is a number in some of the logs, over those logs; what belongs to one
    sensor is left out."""
    means: dict[str, Any] = {}
    for name in dict.fromkeys(name for log in logs for name in log if name != "by_sensor"):
        values = [log[name] for log in logs if log.get(name) is not None]
        if values and isinstance(values[0], dict):
            means[name] = mean_metrics(values)
        else:
            means[name] = float(np.mean(values)) if values else None
    return means


def trained_frames(header: SceneHeader) -> tuple[int, ...]:
    """Frames that the scene was trained on."""
    return tuple(int(frame) for frame in header.training.get("frames", ()))


def perceptual_metric(weights: Path | None) -> Perceptual | None:
    """LPIPS with the weights in a file; None without one. Raises `UnisimError`."""
    if weights is None:
        return None
    from .perceptual import Lpips

    return Lpips(weights)


def _plan(header: SceneHeader, recorded: Drive, options: EvaluationOptions) -> EvaluationPlan:
    trained = trained_frames(header)
    if options.frames is None:
        frames = tuple(frame for frame in recorded.frames if frame not in trained)
        if not frames:
            raise UnisimError(f"{header.path}: was trained on all of the log's frames; name some with --frames")
    else:
        frames = select_frames(options.frames, recorded.frames)
    cameras = options.cameras or tuple(header.training.get("cameras", header.drive.cameras))
    check_names("camera", cameras, recorded.cameras)
    return EvaluationPlan(
        frames=frames,
        cameras=cameras,
        lidars=tuple(name for name in header.training.get("lidars") or header.drive.lidars if name in recorded.lidars),
        width=options.width or header.training.get("width"),
        trained=trained or tuple(frame for frame in recorded.frames if frame not in frames),
        perceptual=perceptual_metric(options.lpips_weights),
        between=True,
        outlines=outlines_from_json(header.training.get("own_vehicle")),
    )
