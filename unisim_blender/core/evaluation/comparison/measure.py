"""The cases of a comparison, and one method at one case: its metrics in a file, some of its images beside it.

Cases are the replay of frames that no method was trained on, and edits whose truth is known.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...data.log import Log
from ...data.own_vehicle import Outline
from ...errors import UnisimError
from ...files import sha256_of_file, write_file
from ...geometry import FloatArray
from ...json_file import json_bytes
from ...output.frame_files import png_bytes
from ...prepare.replay import replayed_drive
from ...prepare.scenario import prepare_scenario
from ...prepare.selection import beam_lidars, spread_frames
from ...render.tracers.surfels.views import outline_in
from ...scenario.edits import Ego
from ..ground_truth import CachedTruth, KnownLog
from ..images import CameraRow, CaptionedImage
from ..perceptual import Inception, frechet_distance
from ..recorded import EvaluationPlan, FrameImages, Perceptual, evaluate, finite
from ..recorded_runs import Progress
from ..truth import summarise_truth
from ..truth_runs import ScenarioRun, compare_frame
from .methods import CompareOptions
from .renderers import MethodRenderer

REPLAY = "replay"


@dataclass(frozen=True)
class Case:
    """``scenario`` is its file, of the replay the log's folder; ``frames`` are compared; ``moves_view`` says that it edits
    nothing but where the vehicle drives."""

    name: str
    scenario: Path
    frames: tuple[int, ...]
    moves_view: bool = False


def cases_of(log: Log, known: KnownLog | None, out: Path, options: CompareOptions) -> list[Case]:
    """Return the replay, and of a log with known ground truth the named scenarios, else the usual edits, which are written
    to ``out`` where the log has none of its own. Raises `UnisimError`."""
    training_frames = options.training_frames(log.drive)
    held_out = tuple(frame for frame in log.drive.frames if frame not in training_frames)
    if not held_out:
        raise UnisimError(f"{log.path}: --frames {options.frames} leaves no frame to compare")
    cases = [Case(REPLAY, log.path, held_out)]
    for scenario in _scenarios(log.path, known, out, options):
        prepared = prepare_scenario(scenario, refined=False)
        edits, name = prepared.scenario.edits, prepared.scenario.name
        if any(case.name == name for case in cases):
            raise UnisimError(f"{scenario}: is a second case named {name!r}")
        among = [frame for frame in prepared.edited.frames if frame not in training_frames]
        frames = spread_frames(prepared.edited, options.truth_frames, among)
        cases.append(Case(name, scenario, frames, all(isinstance(edit, Ego) for edit in edits)))
    return cases


def _scenarios(log: Path, known: KnownLog | None, out: Path, options: CompareOptions) -> tuple[Path, ...]:
    if known is None:
        if options.scenarios:
            raise UnisimError(f"{log}: has no known ground truth, so {options.scenarios[0]} cannot be compared")
        return ()
    if options.scenarios is not None:
        return options.scenarios
    return known.usual_edits(out)


SHOWN = 2
"""Frames of a case whose images the page shows."""


@dataclass
class ComparisonContext:
    """Data that methods are measured on: the log, its ground truth if that is known, and the networks that judge
    images."""

    log: Log
    known: KnownLog | None
    out: Path
    options: CompareOptions
    perceptual: Perceptual | None = None
    inception: Inception | None = None

    @cached_property
    def outlines(self) -> dict[str, tuple[Outline, int]]:
        """The recording vehicle's in its images, for all methods alike: what shows it is not compared.
        Raises `LogError`."""
        frames = self.options.training_frames(self.log.drive)
        return {
            key: outline for name in self.options.cameras for key, outline in outline_in(self.log, name, frames).items()
        }


def measured(
    context: ComparisonContext, name: str, method: MethodRenderer, case: Case, progress: Progress
) -> dict[str, Any]:
    """A method's metrics of a case, from its file where that was measured on the same. Raises `UnisimError`."""
    path = context.out / "metrics" / name / f"{case.name}.json"
    key = _key(context, method, case)
    try:
        document: dict[str, Any] = json.loads(path.read_text())
        if document["key"] == key:
            return document
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    if context.known is None:
        metrics = _recorded(context, name, method, case, progress)
    else:
        metrics = _true(context, context.known, name, method, case, progress)
    document = finite({"key": key, **metrics})
    write_file(path, json_bytes(document))
    return document


def image_path(out: Path, case: str, frame: int, camera: str, shows: str) -> Path:
    """Where an image for the page is; ``shows`` is a method's name, with "-difference" behind it, or "truth"."""
    return out / "images" / case / f"{frame:06d}-{camera}-{shows}.png"


def shown_frames(case: Case) -> tuple[int, ...]:
    """The frames of a case that the page shows."""
    count = len(case.frames)
    return tuple(dict.fromkeys(case.frames[(2 * i + 1) * count // (2 * SHOWN)] for i in range(SHOWN)))


def _key(context: ComparisonContext, method: MethodRenderer, case: Case) -> dict[str, Any]:
    """All that the metrics depend on."""
    w = context.options
    return {
        "renders": method.key,
        "scenario": None if case.name == REPLAY else sha256_of_file(case.scenario),
        "frames": list(case.frames),
        "cameras": list(w.cameras),
        "width": w.width,
        "quality": w.quality,
        "lpips": None if w.lpips is None else sha256_of_file(w.lpips),
        "fid": None if w.fid is None else sha256_of_file(w.fid),
    }


def _recorded(
    context: ComparisonContext, name: str, method: MethodRenderer, case: Case, progress: Progress
) -> dict[str, Any]:
    """The replay beside a real log."""
    log, w = context.log, context.options
    drive = log.drive if method.header is None else replayed_drive(method.header, log)
    renderer = method.renderer(drive)
    plan = EvaluationPlan(
        frames=case.frames,
        cameras=w.cameras,
        lidars=beam_lidars(log),
        width=w.width,
        trained=w.training_frames(log.drive),
        perceptual=context.perceptual,
        outlines=context.outlines,
    )
    judged = _Judged(context, name, case)

    def on_frame(images: FrameImages) -> None:
        for camera, row in zip(
            (c for c in w.cameras if images.frame in log.image_frames(c)), images.rows, strict=False
        ):
            recorded, rendered, difference = row[:3]
            judged.add(images.frame, camera, recorded, rendered, difference)

    metrics = evaluate(renderer, log, plan, on_frame, lambda frames: progress(frames, f"{name}: {case.name}"))
    return {
        "camera": {"edit": metrics["camera"]},
        "lidar": {"edit": metrics["lidar"]},
        "seconds": renderer.medians(),
        "psnr_db": {str(r["frame"]): {c: f["psnr_db"] for c, f in r["camera"].items()} for r in metrics["per_frame"]},
        **judged.fid(),
    }


def _true(
    context: ComparisonContext, known: KnownLog, name: str, method: MethodRenderer, case: Case, progress: Progress
) -> dict[str, Any]:
    """A replay or an edit beside its ground truth."""
    w = context.options
    rendered = prepare_scenario(case.scenario, scene=method.scene, refined=method.scene is not None)
    true = prepare_scenario(case.scenario, refined=False)
    truth = known.truth(true, w.training_frames(context.log.drive), w.cameras, w.width)
    cameras = tuple(camera for camera in w.cameras if camera in true.edited.cameras)
    truth.draw(case.scenario, case.frames, cameras)
    cached = CachedTruth(truth, context.out / "truth" / f"{case.name}-{_digest(context, case)}")
    edited = method.renderer(rendered.edited)
    replay = None if case.name == REPLAY else method.renderer(rendered.recorded)
    run = ScenarioRun(cached, edited, replay, w.width, case.frames, cameras, context.perceptual, replay_sweeps=False)
    judged, per_frame = _Judged(context, name, case), []
    for frame in progress(case.frames, f"{name}: {case.name}"):
        record, images = compare_frame(run, frame)
        per_frame.append(record)
        rows = [row for row in images.rows if isinstance(row, CameraRow)]
        for camera, row in zip(record["camera"], rows, strict=True):
            judged.add(frame, camera, row.truth, row.edited, row.difference)
    return {
        **summarise_truth(per_frame),
        "seconds": edited.medians(),
        "psnr_db": {str(r["frame"]): {c: f["edit"]["psnr_db"] for c, f in r["camera"].items()} for r in per_frame},
        **judged.fid(),
    }


def _digest(context: ComparisonContext, case: Case) -> str:
    """Return a short hash of the inputs, besides the street, that a case's ground truth depends on."""
    w = context.options
    scenario = "" if case.name == REPLAY else sha256_of_file(case.scenario)
    text = json.dumps([scenario, w.width, w.frames, list(w.cameras)])
    return hashlib.sha256(text.encode()).hexdigest()[:12]


class _Judged:
    """Takes a case's images as they are rendered: some for the page, all of them to Inception where it is given."""

    def __init__(self, context: ComparisonContext, name: str, case: Case) -> None:
        self.context, self.name, self.case = context, name, case
        self._features: tuple[list[FloatArray], list[FloatArray]] = [], []

    def add(
        self, frame: int, camera: str, truth: CaptionedImage, rendered: CaptionedImage, difference: CaptionedImage
    ) -> None:
        """One image. Raises `OutputError`."""
        if frame in shown_frames(self.case):
            for shows, tile in (("truth", truth), (self.name, rendered), (f"{self.name}-difference", difference)):
                write_file(image_path(self.context.out, self.case.name, frame, camera, shows), png_bytes(tile.pixels))
        if self.context.inception is not None:
            for features, tile in zip(self._features, (truth, rendered), strict=True):
                features.append(self.context.inception.features(tile.pixels))

    def fid(self) -> dict[str, float]:
        """The distance of the rendered images from the true ones; nothing without Inception."""
        if self.context.inception is None or not self._features[0]:
            return {}
        return {"fid": frechet_distance(*(np.stack(features) for features in self._features))}
