"""A scenario's file and all that it names, opened: the recorded drive and the edited one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..drive import Actor, Drive
from ..edits import apply_scenario
from ..errors import LogError, ScenarioError
from ..geometry import FloatArray
from ..logs import open_log
from ..scenario import load_scenario
from ..scenario.types import Scenario, StreetLog
from ..scene_file import SceneHeader, read_scene_header

ORIGIN_TOLERANCE_M = 1e-6
SAME_DRIVE_M = 1.0
"""Refinement moves poses by centimetres; another drive is metres away."""


class PreparedScenario(NamedTuple):
    """``recorded`` is the drive before any edit, ``edited`` after all; ``scene_path`` is the trained scene's folder, if any."""

    scenario: Scenario
    recorded: Drive
    edited: Drive
    scene_path: Path | None


def prepare_scenario(path: Path, refined: bool = True) -> PreparedScenario:
    """Open the scenario at ``path``, its log and its scene's header, and apply the edits.

    With a trained scene the recorded drive has the scene's refined tracklets and sensor poses, and the log need not be there;
    ``refined=False`` takes the log's own, as the truth of a street needs it. Raises `UnisimError`.
    """
    scenario = load_scenario(path)
    header = None if scenario.scene_path is None else read_scene_header(scenario.scene_path)
    recorded = _log_drive(scenario) if header is None or not refined else _refined_drive(scenario, header)
    return PreparedScenario(scenario, recorded, apply_scenario(scenario, recorded, scene_actors), scenario.scene_path)


def scene_actors(path: Path) -> dict[str, Actor]:
    """The actors of the trained scene in folder ``path``."""
    return read_scene_header(path).drive.actors


def _log_drive(scenario: Scenario) -> Drive:
    path = scenario.log_path
    if not path.exists():
        if isinstance(scenario.log, StreetLog):
            options = " ".join(f"--{name} {value}" for name, value in scenario.log.street.items())
            raise LogError(f"{scenario.path}: log: there is none at {path}; make it with: unisim synth {path} {options}".rstrip())
        raise LogError(f"{scenario.path}: log: there is none at {path}")
    return open_log(path).drive


def _refined_drive(scenario: Scenario, header: SceneHeader) -> Drive:
    """The scene's drive, and from the log, where it is there, the frames and sensors that the scene was not trained on."""
    if not scenario.log_path.exists():
        return header.drive
    log = _log_drive(scenario)
    shared = [frame for frame in header.drive.frames if frame in log.time_s]
    apart = np.linalg.norm(_ego_in_log_world(header.drive, shared) - _ego_in_log_world(log, shared), axis=1)
    if not shared or apart.max() > SAME_DRIVE_M:
        by = f", whose vehicle is {apart.max():.1f} m away at frame {shared[int(apart.argmax())]}" if shared else ""
        raise ScenarioError(f"{scenario.path}: scene: {scenario.scene} was trained on another drive than {scenario.log_path}{by}")
    if np.abs(header.drive.world_origin - log.world_origin).max() > ORIGIN_TOLERANCE_M:
        origins = f"{header.drive.world_origin.tolist()}, the log at {log.world_origin.tolist()}"
        raise ScenarioError(f"{scenario.path}: scene: {scenario.scene} has its origin at {origins}")
    return replace(
        header.drive,
        frames=log.frames,
        time_s=log.time_s,
        cameras={**log.cameras, **header.drive.cameras},
        lidars={**log.lidars, **header.drive.lidars},
    )


def _ego_in_log_world(drive: Drive, frames: list[int]) -> FloatArray:
    """Positions (F, 3) of the vehicle at frames, in the log's own coordinates."""
    times = np.array([drive.time_s[frame] for frame in frames])
    return np.asarray(drive.world_from_ego.at(times)[:, :3, 3] + drive.world_origin)
