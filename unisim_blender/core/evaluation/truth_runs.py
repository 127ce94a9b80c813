"""Scenarios against the truth of their log, from paths to files: metrics.json, a page, and a contact sheet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ScenarioError
from ..files import holds_out, write_file
from ..formats.readers import open_log
from ..json_file import json_bytes
from ..prepare.scenario import prepare_scenario
from ..prepare.scenario_plan import scenario_hash
from ..prepare.selection import check_names, select_frames
from ..render.code_identity import code_identity
from .ground_truth import TrueImages, Truth, Version, require_known_log
from .images import CameraRow, CaptionedImage, camera_row, sweep_tile, write_contact_sheet
from .metrics import ImageArray
from .recorded import FrameImages, Perceptual, RayRenderer, TimedRenderer, finite
from .recorded_runs import EvaluationOptions, Progress, Report, perceptual_metric, trained_frames
from .truth import edit_image_metrics, lidar_metrics_beside, summarise_truth


@dataclass(frozen=True)
class ScenarioRun:
    """One scenario twice: as a renderer shows it, and as the truth has it. ``replay`` renders the recorded drive, to
    tell what the edit costs; None where nobody asks. ``replay_sweeps`` says whether its sweeps are wanted, too."""

    truth: Truth
    edited: RayRenderer
    replay: RayRenderer | None
    width: int | None
    frames: tuple[int, ...]
    cameras: tuple[str, ...]
    perceptual: Perceptual | None = None
    replay_sweeps: bool = True


@holds_out
def evaluate_scenarios(
    log_path: Path,
    scenarios: tuple[Path, ...],
    out: Path,
    options: EvaluationOptions,
    progress: Progress,
    scene: Path | None = None,
) -> dict[str, Any]:
    """Compare scenarios with the truth of their edits on the log at ``log_path``; the metrics by scenario.

    They are rendered with ``scene``, or each with the one that it names. Several scenarios are written to folders of
    their names below ``out``. Raises `UnisimError`.
    """
    if len(scenarios) == 1:
        return evaluate_scenario(log_path, scenarios[0], out, options, progress, scene)
    metrics = {}
    for path in scenarios:
        metrics[path.stem] = evaluate_scenario(log_path, path, out / path.stem, options, progress, scene)
    write_file(out / "metrics.json", json_bytes(metrics))
    Report(out, "Edits against the truth").finish(metrics)
    return metrics


@holds_out
def evaluate_scenario(
    log_path: Path, scenario: Path, out: Path, options: EvaluationOptions, progress: Progress, scene: Path | None = None
) -> dict[str, Any]:
    """Compare one scenario with the truth of its edits and write ``out``; the metrics without those
    of single frames."""
    rendered, true = prepare_scenario(scenario, scene=scene), prepare_scenario(scenario, refined=False, scene=scene)
    if rendered.scene is None:
        raise ScenarioError(f"{scenario}: scene: names no trained scene to render with; give one with --scene")
    opened, header = rendered.scene, rendered.scene.header
    others = rendered.scenes.others(rendered.edited)
    name, width = rendered.scenario.name, options.width or header.training.get("width")
    drive = rendered.edited
    frames = drive.frames if options.frames is None else select_frames(options.frames, sorted(drive.time_s))
    cameras = options.cameras or tuple(drive.cameras)
    check_names("camera", cameras, drive.cameras)
    log, known = open_log(log_path), require_known_log(log_path)
    truth = known.truth(true, trained_frames(header), tuple(header.training.get("cameras", ())), width)
    truth.draw(scenario, frames, cameras)
    edited, replay = options.renderer(opened, others, log), options.renderer(opened, {}, log)
    replay.detail = edited.detail  # its references are rendered once
    run = ScenarioRun(
        truth,
        TimedRenderer(edited, drive),
        TimedRenderer(replay, rendered.recorded),
        width,
        frames,
        cameras,
        perceptual_metric(options.lpips_weights),
    )
    report, per_frame, rows = Report(out, f"{name} against the truth"), [], []
    for frame in progress(frames, name):
        record, images = compare_frame(run, frame)
        per_frame.append(record)
        rows += images.rows
        report.add(images)
    metrics = summarise_truth(per_frame)
    about = {
        "scenario": {"name": name, "sha256": scenario_hash(rendered.scenario)},
        "scene": {"name": header.name, "sha256": opened.digest},
        "street": known.name,
        "code": code_identity(),
        "quality": options.quality,
        "detail": options.detail,
        "width": width,
        "frames": list(frames),
        "trained_frames": list(trained_frames(header)),
    }
    write_file(out / "metrics.json", json_bytes({**about, **metrics, "per_frame": finite(per_frame)}))
    write_contact_sheet(out / "contact_sheet.png", rows)
    report.finish(metrics)
    return metrics


def compare_frame(run: ScenarioRun, frame: int) -> tuple[dict[str, Any], FrameImages]:
    """All sensors of one frame: metrics, and a row of images each."""
    images = FrameImages(frame)
    record: dict[str, Any] = {"frame": frame, "camera": {}, "lidar": {}}
    edited = run.truth.drive("edit")
    for name in run.cameras:
        if frame in edited.cameras[name].time_s:
            record["camera"][name], row = _compare_camera(run, name, frame)
            images.rows.append(row)
    for name, lidar in edited.lidars.items():
        if frame in lidar.time_s:
            record["lidar"][name], tiles = _compare_lidar(run, name, frame)
            images.rows.append(tiles)
    return record, images


def _compare_camera(run: ScenarioRun, name: str, frame: int) -> tuple[dict[str, Any], CameraRow]:
    true = run.truth.images(name, frame)
    edited, replay = _image(run.edited, name, frame, run.width), None
    metrics = {"edit": _metrics(run, edited, true.edit, true)}
    if true.replay is not None and run.replay is not None:
        replay = _image(run.replay, name, frame, run.width)
        if replay.shape == edited.shape:
            metrics["replay"] = _metrics(run, replay, true.replay, true)
    return metrics, camera_row(f"{name} {frame}", true.replay, replay, edited, true.edit, true.regions.changed)


def _metrics(run: ScenarioRun, rendered: ImageArray, truth: ImageArray, true: TrueImages) -> dict[str, Any]:
    metrics = edit_image_metrics(rendered, truth, true.regions)
    if run.perceptual is not None:
        metrics["lpips"] = run.perceptual(rendered, truth)
    return metrics


def _compare_lidar(run: ScenarioRun, name: str, frame: int) -> tuple[dict[str, Any], list[CaptionedImage]]:
    metrics: dict[str, Any] = {}
    tiles: dict[str, CaptionedImage] = {}
    versions: tuple[tuple[Version, RayRenderer | None], ...] = (
        ("replay", run.replay if run.replay_sweeps else None),
        ("edit", run.edited),
    )
    for version, renderer in versions:
        truth = None if renderer is None else run.truth.sweep(version, name, frame)
        if renderer is None or truth is None:
            continue
        drive = run.truth.drive(version)
        metrics[version], rendered, true = lidar_metrics_beside(renderer, truth, drive.lidars[name].blocked)
        ego = drive.world_from_ego.at(drive.time_s[frame])
        size = (run.width or next((c.model.width for c in drive.cameras.values()), 480), 360)
        labels = (f"{name} {frame}: recorded", "replay") if version == "replay" else ("truth of the edit", "edited")
        tiles[f"{version} truth"] = sweep_tile(labels[0], true, ego, size)
        tiles[version] = sweep_tile(labels[1], rendered, ego, size)
    return metrics, [tiles[key] for key in ("replay truth", "replay", "edit", "edit truth") if key in tiles]


def _image(renderer: RayRenderer, camera: str, frame: int, width: int | None) -> ImageArray:
    return np.clip(renderer.camera(camera, frame, ("rgb",), width).rgb, 0, 1)
