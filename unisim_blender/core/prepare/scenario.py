"""A scenario's file and all that it names, opened: the recorded drive and the edited one."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from ..data import open_log
from ..data.readers import reader_of
from ..errors import LogError, ScenarioError, SceneError
from ..model.files.scene_file import HEADER_NAME, SceneHeader, read_scene_header
from ..scenario import FORMAT, apply_scenario, load_scenario, scenario_from_json
from ..scenario.types import Scenario, StreetLog
from ..world.drive import Actor, Drive
from .replay import replayed_drive
from .scenes import stamp


class PreparedScenario(NamedTuple):
    """``recorded`` is the drive before any edit, ``edited`` after all; ``scene_path`` is the trained
    scene's folder, if any."""

    scenario: Scenario
    recorded: Drive
    edited: Drive
    scene_path: Path | None


def prepare_scenario(source: Path | Scenario, refined: bool = True, scene: Path | None = None) -> PreparedScenario:
    """Open a scenario or the one at a path, its log and its scene's header, and apply the edits. A log is a
    scenario without any, and so is a trained scene.

    With a trained scene the recorded drive has the scene's refined tracklets and sensor poses, and the log need not be
    there; ``refined=False`` takes the log's own, as the truth of a street needs it. ``scene`` takes the place of the
    trained scene that the scenario names. Raises `UnisimError`.
    """
    scenario = source if isinstance(source, Scenario) else scenario_at(source)
    if scene is not None:
        scenario = replace(scenario, scene=str(scene.resolve()))
    recorded = recorded_drive(scenario, refined)
    return PreparedScenario(scenario, recorded, apply_scenario(scenario, recorded, scene_actors), scenario.scene_path)


def scenario_at(path: Path) -> Scenario:
    """Return the scenario at ``path``; a log or a trained scene is one without edits. Raises `UnisimError`."""
    if (path / HEADER_NAME).is_file():
        return _of_scene(path)
    return _of_log(path) if path.is_dir() or reader_of(path) is not None else load_scenario(path)


def _of_log(path: Path) -> Scenario:
    """The scenario in which a log goes as it was recorded."""
    folder, log = (path, ".") if path.is_dir() else (path.parent, path.name)
    document = {"format": FORMAT, "version": 1, "name": path.resolve().name, "log": log, "edits": []}
    return scenario_from_json(document, folder / "scenario.json")


def _of_scene(path: Path) -> Scenario:
    """The scenario in which a trained scene's log goes as it was recorded."""
    header = read_scene_header(path)
    document = {
        "format": FORMAT, "version": 1, "name": header.name, "log": header.log_path, "scene": ".", "edits": [],
    }  # fmt: skip
    return scenario_from_json(document, path / "scenario.json")


def recorded_drive(scenario: Scenario, refined: bool = True) -> Drive:
    """The drive that a scenario's edits begin with. Raises `UnisimError`."""
    header = None if scenario.scene_path is None else read_scene_header(scenario.scene_path)
    return _log_drive(scenario) if header is None or not refined else _replayed_drive(scenario, header)


def scene_actors(path: Path) -> dict[str, Actor]:
    """The actors of the trained scene in folder ``path``; those of a scene that was read before are kept."""
    return _scene_actors(stamp(path))


@lru_cache(maxsize=8)
def _scene_actors(stamped: tuple[Any, ...]) -> dict[str, Actor]:
    return read_scene_header(stamped[0]).drive.actors


def _log_drive(scenario: Scenario) -> Drive:
    path = scenario.log_path
    if not path.exists():
        if isinstance(scenario.log, StreetLog):
            options = " ".join(f"--{name} {value}" for name, value in scenario.log.street.items())
            raise LogError(
                f"{scenario.path}: log: there is none at {path}; make it with: unisim synth {path} {options}".rstrip()
            )
        raise LogError(f"{scenario.path}: log: there is none at {path}")
    return open_log(path).drive


def _replayed_drive(scenario: Scenario, header: SceneHeader) -> Drive:
    """The scene's drive, with the log's other frames and sensors where the log is there."""
    if not scenario.log_path.exists():
        return header.drive
    try:
        return replayed_drive(header, _log_drive(scenario), scenario.log_path)
    except SceneError as error:
        raise ScenarioError(f"{scenario.path}: scene: {error}") from error
