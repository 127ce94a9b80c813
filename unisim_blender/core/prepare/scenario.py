"""A scenario's file and all that it names, opened: the recorded drive and the edited one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ..actor_images.lamps import lamps_in
from ..data.log import Log
from ..errors import LogError, ScenarioError, SceneError, UnisimError
from ..formats.boxes import with_boxes
from ..formats.readers import DRIVE, drive_in, open_log, reader_of
from ..json_file import read_json
from ..memo import memoized
from ..model.scene_file import HEADER_NAME, read_scene_header
from ..remote.copies import MissingInput, local_path
from ..remote.requests import is_url, last_part
from ..scenario import FORMAT, apply_scenario, at_url, load_scenario, scenario_from_json
from ..scenario.types import Scenario, StreetLog
from ..scenes.scene import OpenScenes, Scene
from ..world.drive import Drive
from ..world.lamps import ActorLamp
from .replay import aligned_log, replayed_drive


class PreparedScenario(NamedTuple):
    """``recorded`` is the drive before any edit, ``edited`` after all; ``scene`` is the trained scene, if any, and ``log_path``
    the log's folder: where a trained scene is rendered, of a log at a URL only what tells its drive is there. ``scenes`` has
    opened the scene and those that actors were inserted from."""

    scenario: Scenario
    recorded: Drive
    edited: Drive
    scene: Scene | None
    log_path: Path
    scenes: OpenScenes


def prepare_scenario(
    source: Path | str | Scenario,
    refined: bool = True,
    scene: Path | str | None = None,
    scenes: OpenScenes | None = None,
    boxes: Path | None = None,
) -> PreparedScenario:
    """Open a scenario or the one at a path or a URL, its log and its scene's header, and apply the edits. A log is a
    scenario without any, and so is a trained scene.

    With a trained scene the recorded drive has the scene's refined tracklets and sensor poses, and the log need not be
    there; ``refined=False`` takes the log's own, as the truth of a street needs it. ``scene`` takes the place of the
    trained scene that the scenario names, the file ``boxes`` that of the log's boxes; ``scenes`` are those that were
    opened before. Raises `UnisimError`.
    """
    scenes = OpenScenes() if scenes is None else scenes
    scenario = source if isinstance(source, Scenario) else scenario_at(source, scenes)
    if scene is not None:
        scenario = replace(scenario, scene=str(scene) if is_url(scene) else str(Path(scene).resolve()))
    own = None
    if scenario.scene_path is not None:
        own = scenes.open(scenario.scene_path) if refined else Scene(scenario.scene_path)
    if boxes is not None:
        if own is not None and refined:
            raise ScenarioError(
                f"--boxes {boxes}: {own.path} shows the actors that it was trained on; train it on these"
            )
        scenario = replace(scenario, log=str(with_boxes(scenario.log_path, boxes).resolve()))
    recorded, log_path = _recorded(scenario, own if refined else None)
    edited = apply_scenario(scenario, recorded, scenes.actors, lambda: lamps_at(log_path, own if refined else None))
    return PreparedScenario(scenario, recorded, edited, own, log_path, scenes)


def lamps_at(
    log_path: Path, scene: Scene | None, progress: Callable[[float], object] = lambda share: None
) -> Mapping[str, tuple[ActorLamp, ...]]:
    """Return the lamps that the images of the log at a path show in two states, in the world of its scene (`lamps_in`)."""
    return lamps_in(open_log(log_path) if scene is None else log_of_scene(scene, log_path), progress)


def scenario_at(path: Path | str, scenes: OpenScenes | None = None) -> Scenario:
    """Return the scenario at a path or a URL; a log or a trained scene is one without edits. Raises `UnisimError`."""
    if is_url(path):
        return _at_url(str(path).rstrip("/"))
    path = Path(path)
    if (document := _document(path)) is not None:
        return scenario_from_json(document, path)
    if (path / HEADER_NAME).is_file():
        return _of_scene((scenes or OpenScenes()).open(path))
    if path.is_dir() or reader_of(path) is not None:
        return _of_log(drive_in(path))
    return load_scenario(path)


def _document(path: Path) -> dict[str, Any] | None:
    """Return the JSON object of a file that says that it is a scenario; None for any other, which may be a log's."""
    if path.suffix != ".json" or not path.is_file():
        return None
    try:
        document = read_json(path, ScenarioError)
    except ScenarioError:
        return None
    return document if isinstance(document, dict) and document.get("format") == FORMAT else None


def _at_url(url: str) -> Scenario:
    if url.endswith(".json"):
        copy = local_path(url)
        with named(copy, url):
            return at_url(load_scenario(copy), url)
    place = Path(last_part(url)) / "scenario.json"
    document = {"format": FORMAT, "version": 1, "name": last_part(url), "log": url, "edits": []}
    try:
        header = read_scene_header(local_path(f"{url}/{HEADER_NAME}"))
    except MissingInput:
        return scenario_from_json(document, place)
    document |= {"name": header.name, "log": header.log_path, "scene": "."}
    return at_url(scenario_from_json(document, place), f"{url}/scenario.json")


@contextmanager
def named(copy: Path, url: str) -> Iterator[None]:
    """Within it, errors that name the copy of a file name its URL."""
    try:
        yield
    except UnisimError as error:
        raise type(error)(str(error).replace(str(copy), url), remedy=error.remedy) from error


def _of_log(path: Path) -> Scenario:
    """The scenario in which a log goes as it was recorded."""
    folder, log = (path, ".") if path.is_dir() else (path.parent, path.name)
    document = {"format": FORMAT, "version": 1, "name": path.resolve().name, "log": log, "edits": []}
    return scenario_from_json(document, folder / "scenario.json")


def _of_scene(scene: Scene) -> Scenario:
    """The scenario in which a trained scene's log goes as it was recorded."""
    header = scene.header
    document = {
        "format": FORMAT, "version": 1, "name": header.name, "log": header.log_path, "scene": ".", "edits": [],
    }  # fmt: skip
    return scenario_from_json(document, scene.path / "scenario.json")


def _recorded(scenario: Scenario, scene: Scene | None) -> tuple[Drive, Path]:
    """The drive that a scenario's edits begin with, refined by its ``scene`` if one is given, and where its log lies. Raises
    `UnisimError`."""
    if scene is None:
        return _log_at(scenario, scenario.log_path).drive, scenario.log_path
    if not is_url(scenario.log_name):
        return _replayed_drive(scenario, scene, scenario.log_path), scenario.log_path
    try:
        path = local_path(scenario.log_name, DRIVE)
        return _replayed_drive(scenario, scene, path), path
    except MissingInput:
        return scene.header.drive, scenario.path.parent / last_part(scenario.log_name)
    except LogError:  # its reader needs more
        return _replayed_drive(scenario, scene, scenario.log_path), scenario.log_path


def _log_at(scenario: Scenario, path: Path) -> Log:
    if not path.exists():
        if isinstance(scenario.log, StreetLog):
            options = " ".join(f"--{name} {value}" for name, value in scenario.log.street.items())
            raise LogError(
                f"{scenario.path}: log: there is none at {path}; make it with: unisim synth {path} {options}".rstrip()
            )
        raise LogError(f"{scenario.path}: log: there is none at {path}")
    return open_log(path)


@memoized
def log_of_scene(scene: Scene, path: Path) -> Log:
    """The log at a path in the world of a scene that was trained on its drive. Raises `UnisimError`."""
    return aligned_log(scene.header, open_log(path))


def _replayed_drive(scenario: Scenario, scene: Scene, path: Path) -> Drive:
    """The scene's drive, with the log's other frames and sensors where the log is there."""
    if not path.exists():
        return scene.header.drive
    try:
        return replayed_drive(scene.header, log_of_scene(scene, path))
    except SceneError as error:
        raise ScenarioError(f"{scenario.path}: scene: {error}") from error
