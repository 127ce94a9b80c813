"""From a scenario's file to what is rendered: its own wishes, and over them the command line's."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

from ..errors import ScenarioError
from ..frames import CAMERA_PASSES
from ..output.frame_files import FORMATS
from ..scenario import scenario_to_json
from ..scenario.types import Outputs, Scenario
from ..sequence.plan import RenderPlan, SequenceSettings
from .renderers import SceneSource, environment, scene_hashes
from .scenario import PreparedScenario, prepare_scenario
from .selection import check_names, select_frames

SEQUENCE_FORMATS = ("pandaset", "video")
"""Formats that are made of a whole sequence, after its frames."""


@dataclass(frozen=True)
class Wishes:
    """What the command line asks for; None leaves it to the scenario, and then to the defaults."""

    frames: str | None = None
    sensors: tuple[str, ...] | None = None
    passes: tuple[str, ...] | None = None
    width: int | None = None
    quality: str | None = None
    device: str = "cpu"
    draw: int | None = None


def plan_scenario(path: Path, wishes: Wishes) -> tuple[RenderPlan, PreparedScenario]:
    """Open a scenario and say what to render of it with its trained scene. Raises `UnisimError`."""
    prepared = prepare_scenario(path)
    if prepared.scene_path is None:
        raise ScenarioError(f'{path}: scene: names no trained scene to render with; train one with "unisim train"')
    drive, outputs = prepared.edited, prepared.scenario.outputs or Outputs()
    # a log's plain points, without a beam table, are no sensor that could be simulated
    there = (*drive.cameras, *(name for name, lidar in drive.lidars.items() if lidar.model.beams))
    sensors = there if wishes.sensors is None else wishes.sensors
    check_names("sensor", sensors, there)
    passes = wishes.passes or outputs.passes or ("rgb",)
    check_names("pass", passes, CAMERA_PASSES)
    frames = drive.frames if wishes.frames is None else select_frames(wishes.frames, sorted(drive.time_s))
    quality = wishes.quality or outputs.quality or "balanced"
    settings = SequenceSettings(
        cameras=tuple(name for name in drive.cameras if name in sensors),
        lidars=tuple(name for name in drive.lidars if name in sensors),
        # rgb is always there: it is what the picture's files hold
        passes=tuple(name for name in CAMERA_PASSES if name in passes or name == "rgb"),
        formats=tuple(name for name in FORMATS if name in (outputs.formats or FORMATS)),
        width=wishes.width or outputs.width,
        quality=quality,
        device=wishes.device,
        draw=wishes.draw,
        contact_shadows=bool(outputs.contact_shadows),
    )
    about = {
        "scenario": {"name": prepared.scenario.name, "sha256": scenario_hash(prepared.scenario)},
        "log": {"name": drive.name, "world_origin": drive.world_origin.tolist()},
    }
    source = SceneSource(prepared.scene_path, drive, quality, wishes.device, wishes.draw, settings.contact_shadows)
    hashes = scene_hashes(prepared.scene_path, drive)
    return RenderPlan(drive, frames, settings, source, hashes, environment(wishes.device), about), prepared


def sequence_formats(scenario: Scenario) -> tuple[str, ...]:
    """The formats of `SEQUENCE_FORMATS` that a scenario asks for."""
    wanted = (scenario.outputs or Outputs()).formats or ()
    return tuple(name for name in SEQUENCE_FORMATS if name in wanted)


def scenario_hash(scenario: Scenario) -> str:
    """A digest of the document, whatever its layout, and wherever it, its log and its scenes lie."""
    document = scenario_to_json(scenario)
    for part in (document, *document.get("edits", ())):
        for path in ("log", "scene", "mesh"):
            part.pop(path, None)
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
