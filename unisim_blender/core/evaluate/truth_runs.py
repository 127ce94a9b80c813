"""Scenarios of a street against its truth, from paths to files: metrics.json, a page, and a contact sheet."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..drive import Drive
from ..errors import ScenarioError
from ..files import write_file
from ..output.frame_files import json_bytes
from ..prepare.renderers import SceneSource, scene_hash
from ..prepare.scenario import PreparedScenario, prepare_scenario
from ..prepare.scenario_plan import scenario_hash
from ..prepare.selection import check_names, select_frames
from ..prepare.street import street_of
from ..render import Renderer
from ..scene_file import SceneHeader, read_scene_header
from ..sequence.plan import code_identity
from ..street.edit_masks import edit_masks
from ..street.path_tracer import Wanted, draw_truths
from ..street.street import Street, load_street
from ..street.true_pictures import lacks_pictures, true_picture
from ..street.truth import truth_camera, truth_lidar
from .contact_sheet import camera_row, sweep_tile, write_contact_sheet
from .metrics import Picture
from .pictures import Tile
from .recorded import FramePictures, finite
from .recorded_runs import EvaluationWishes, Progress, trained_frames
from .report import Report
from .truth import EditRegions, lidar_figures_beside, picture_figures, summarise_truth


@dataclass
class ScenarioRun:
    """One scenario opened twice: as its scene renders it, and with the log's own poses as the truth has it."""

    street: Street
    street_path: Path
    header: SceneHeader
    rendered: PreparedScenario
    true: PreparedScenario
    edited: Renderer
    replay: Renderer
    width: int | None
    frames: tuple[int, ...]
    cameras: tuple[str, ...]
    rows: list[list[Tile]] = field(default_factory=list)


def evaluate_scenarios(
    street_path: Path, scenarios: tuple[Path, ...], out: Path, wishes: EvaluationWishes, progress: Progress
) -> dict[str, Any]:
    """Compare scenarios with the truth of their edits on the street at ``street_path``; the figures by scenario.

    Several scenarios are written to folders of their names below ``out``. Raises `UnisimError`.
    """
    if len(scenarios) == 1:
        return evaluate_scenario(street_path, scenarios[0], out, wishes, progress)
    figures = {}
    for path in scenarios:
        figures[path.stem] = evaluate_scenario(street_path, path, out / path.stem, wishes, progress)
    write_file(out / "metrics.json", json_bytes(figures))
    Report(out, "Edits against the truth").finish(figures)
    return figures


def evaluate_scenario(
    street_path: Path, scenario: Path, out: Path, wishes: EvaluationWishes, progress: Progress
) -> dict[str, Any]:
    """Compare one scenario with the truth of its edits and write ``out``; the figures without those of single frames."""
    run = open_run(street_path, scenario, wishes)
    if lacks_pictures(street_path, run.street, (run.true.edited, run.true.recorded), run.cameras, run.frames, run.width):
        draw_truths(street_path, (Wanted(scenario, run.frames, run.cameras),), run.width, progress=True)
    report = Report(out, f"{run.rendered.scenario.name} against the truth")
    per_frame = []
    for frame in progress(run.frames, run.rendered.scenario.name):
        record, pictures = compare_frame(run, frame)
        per_frame.append(record)
        run.rows += pictures.rows
        report.add(pictures)
    figures = summarise_truth(per_frame)
    about = {
        "scenario": {"name": run.rendered.scenario.name, "sha256": scenario_hash(run.rendered.scenario)},
        "scene": {"name": run.header.name, "sha256": scene_hash(run.header.path)},
        "street": run.street.drive.name,
        "code": code_identity(),
        "quality": wishes.quality,
        "width": run.width,
        "frames": list(run.frames),
        "trained_frames": list(trained_frames(run.header)),
    }
    write_file(out / "metrics.json", json_bytes({**about, **figures, "per_frame": finite(per_frame)}))
    write_contact_sheet(out / "contact_sheet.png", run.rows)
    report.finish(figures)
    return figures


def open_run(street_path: Path, scenario: Path, wishes: EvaluationWishes) -> ScenarioRun:
    """Open all that a scenario's evaluation needs. Raises `UnisimError`."""
    rendered, true = prepare_scenario(scenario), prepare_scenario(scenario, refined=False)
    if rendered.scene_path is None:
        raise ScenarioError(f"{scenario}: scene: names no trained scene to render with")
    header = read_scene_header(rendered.scene_path)
    drive = rendered.edited
    frames = drive.frames if wishes.frames is None else select_frames(wishes.frames, sorted(drive.time_s))
    cameras = wishes.cameras or tuple(drive.cameras)
    check_names("camera", cameras, drive.cameras)
    return ScenarioRun(
        street=street_of(load_street(street_path), true.edited),
        street_path=street_path,
        header=header,
        rendered=rendered,
        true=true,
        edited=SceneSource(rendered.scene_path, drive, wishes.quality, wishes.device)(),
        replay=SceneSource(rendered.scene_path, rendered.recorded, wishes.quality, wishes.device)(),
        width=wishes.width or header.training.get("width"),
        frames=frames,
        cameras=cameras,
    )


def compare_frame(run: ScenarioRun, frame: int) -> tuple[dict[str, Any], FramePictures]:
    """All sensors of one frame: figures, and a row of pictures each."""
    pictures = FramePictures(frame)
    record: dict[str, Any] = {"frame": frame, "camera": {}, "lidar": {}}
    for name in run.cameras:
        if frame in run.true.edited.cameras[name].time_s:
            record["camera"][name], row = _compare_camera(run, name, frame)
            pictures.rows.append(row)
    for name, lidar in run.true.edited.lidars.items():
        if frame in lidar.time_s:
            record["lidar"][name], row = _compare_lidar(run, name, frame)
            pictures.rows.append(row)
    return record, pictures


def _compare_camera(run: ScenarioRun, name: str, frame: int) -> tuple[dict[str, Any], list[Tile]]:
    width = run.width
    truth = _true_picture(run, run.true.edited, name, frame)
    trained = tuple(camera for camera in run.header.training.get("cameras", ()) if camera in run.true.recorded.cameras)
    masks = edit_masks(
        run.street, run.true.recorded, run.true.edited, name, frame, trained_frames(run.header), trained or None, width
    )
    regions = EditRegions(masks.edited, masks.shadow, masks.seen)
    edited = _picture(run.edited, name, frame, width)
    found = {"edit": picture_figures(edited, truth, regions)}
    recorded = replay = None
    if name in run.true.recorded.cameras:
        recorded = _true_picture(run, run.true.recorded, name, frame)
        replay = _picture(run.replay, name, frame, width)
        if replay.shape == edited.shape:
            found["replay"] = picture_figures(replay, recorded, regions)
    return found, camera_row(f"{name} {frame}", recorded, replay, edited, truth, regions.changed)


def _compare_lidar(run: ScenarioRun, name: str, frame: int) -> tuple[dict[str, Any], list[Tile]]:
    drives = {"edit": run.true.edited, "replay": run.true.recorded}
    found, tiles = {}, {}
    for part, renderer in (("replay", run.replay), ("edit", run.edited)):
        drive = drives[part]
        if name not in drive.lidars:
            continue
        truth = truth_lidar(run.street, drive, name, frame)
        found[part], rendered, true = lidar_figures_beside(renderer, truth, drive.lidars[name].blocked)
        ego = drive.world_from_ego.at(drive.time_s[frame])
        size = (run.width or next((c.model.width for c in drive.cameras.values()), 480), 360)
        labels = (f"{name} {frame}: recorded", "replay") if part == "replay" else ("truth of the edit", "edited")
        tiles[f"{part} truth"] = sweep_tile(labels[0], true.points, true.intensity, ego, size)
        tiles[part] = sweep_tile(labels[1], rendered.points, rendered.intensity, ego, size)
    return found, [tiles[key] for key in ("replay truth", "replay", "edit", "edit truth") if key in tiles]


def _picture(renderer: Renderer, camera: str, frame: int, width: int | None) -> Picture:
    return np.clip(renderer.camera(camera, frame, ("rgb",), width).rgb, 0, 1)


def _true_picture(run: ScenarioRun, drive: Drive, camera: str, frame: int) -> Picture:
    """What the camera truly sees: drawn now, or by Cycles before."""
    if run.street.recipe.engine == "exact":
        return truth_camera(run.street, drive, camera, frame, run.width).rgb
    return true_picture(run.street_path, run.street, drive, camera, frame, run.width)
