"""A finished folder to export: a tiny sequence whose labels, images and sweeps are there, and lines of a rollout."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tiny_drive import tiny_plan

from unisim_blender.core.sequence.run import render_sequence
from unisim_blender.core.simulation.rollout.steps import STEPS_NAME, Step
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Control, Plan

FRAMES = (0, 1, 3)
PLAN = Plan(
    np.array([100_000, 200_000, 300_000]),
    np.array([0.5, 1.0, 1.5]),
    np.array([0.0, 0.1, 0.3]),
    np.array([0.0, 0.1, 0.2]),
)
STEPS = (
    Step(0, EgoState(0.0, 0.0, 0.0, 5.0), {}),
    Step(100_000, EgoState(0.5, 0.01, 0.02, 4.9, -1.0, 0.05), {}, PLAN),
    Step(200_000, EgoState(1.0, 0.02, 0.04, 4.8, -1.1, 0.06), {}, Control(-1.0, 0.1)),
)


def render_tiny(out: Path, earlier_s: float = 0.0) -> Path:
    """Render some frames of the tiny drive, all of its sensors ``earlier_s`` before their frames; the folder."""
    plan = tiny_plan()
    drive = plan.drive
    times = {frame: time_s - earlier_s for frame, time_s in drive.time_s.items()}
    cameras = {name: replace(camera, time_s=times) for name, camera in drive.cameras.items()}
    drive = replace(drive, cameras=cameras)
    moments = tuple(plan.moment_of_frame(frame) for frame in FRAMES)
    settings = replace(plan.settings, formats=("png", "npz", "labels"), passes=("rgb",))
    plan = replace(plan, drive=drive, settings=settings)
    moments = tuple(plan.moment_of_frame(frame) for frame in FRAMES)
    render_sequence(replace(plan, moments=moments), out)
    return out


def as_rollout(folder: Path) -> Path:
    """Write the steps of a rollout into a finished folder; the folder."""
    (folder / STEPS_NAME).write_text("".join(json.dumps(step.to_json()) + "\n" for step in STEPS))
    return folder


def labels_of(folder: Path) -> list[dict[str, Any]]:
    """The labels' documents, in the order of frames."""
    return [json.loads(path.read_text()) for path in sorted((folder / "labels").glob("*.json"))]


def all_files(folder: Path) -> dict[str, bytes]:
    """Every file's bytes below a folder, or a file's, by its path below it."""
    paths = [folder] if folder.is_file() else sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
