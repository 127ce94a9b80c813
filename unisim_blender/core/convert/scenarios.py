"""The formats that scenarios are converted to and from, and how they are written: whole or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..data.log import extras_of
from ..errors import OutputError
from ..files import hold_folder
from ..formats.alpasim import write as alpasim
from ..formats.openscenario import read as openscenario_reader
from ..formats.openscenario import write as openscenario_writer
from ..formats.readers import open_log
from ..prepare.scenario import PreparedScenario, prepare_scenario
from ..prepare.scenario_plan import RenderOptions
from ..scenario import rebased, save_scenario, scenario_to_json
from ..scenario.types import Scenario
from ..serve.scenes import open_served_scene
from ..simulation.rollout.steps import SCENARIO_NAME
from ..simulation.vehicle.parameters import Vehicle
from ..world.drive import Drive

NAMED = 5


def losses_of(scenario: Scenario, drive: Drive, sensors: bool) -> list[str]:
    """Return a sentence for each part of a scenario, and of its edited drive, that a format without appearances leaves out;
    ``sensors``: whether it has none for sensors either."""
    found = []
    foreign = [uid for uid, one in drive.actors.items() if one.appearance.mesh or one.appearance.scene]
    if foreign:
        found.append(f"where {named(foreign)} look as they do: meshes and other scenes' actors are not written")
    if any(one.is_ego_body for one in drive.actors.values()):
        found.append("the ego vehicle's body: its mesh is not written")
    if drive.static_copies or len(drive.static_removals):
        found.append("copied and removed boxes of the static world are not written")
    if sensors and scenario.sensors is not None:
        found.append("the scenario's sensors are not written")
    if scenario.simulation is not None and scenario.simulation.actors:
        found.append("the actors' models of simulation.actors are not written: they go as the edits have them")
    return found


def named(names: list[str]) -> str:
    """Return names in a sentence, the first few where there are many."""
    shown = ", ".join(names[:NAMED])
    return shown if len(names) <= NAMED else f"{shown} and {len(names) - NAMED} more"


@dataclass(frozen=True)
class Exchanged:
    """Result of a conversion: the ``file`` that it wrote, and a sentence for each thing that was lost or not
    understood."""

    file: Path
    losses: tuple[str, ...]


@dataclass(frozen=True)
class ScenarioFormat:
    """A format by its name. ``write`` gets a scenario, a log or a trained scene, and an empty folder; it returns the file's name
    below it, and the losses."""

    name: str
    about: str
    write: Callable[[Path, Path], tuple[str, tuple[str, ...]]]


def _prepared(path: Path) -> tuple[PreparedScenario, Vehicle]:
    """The scenario at a path, opened, and its ego vehicle."""
    prepared = prepare_scenario(path)
    spec = prepared.scenario.simulation
    return prepared, Vehicle.from_dict((spec.vehicle if spec else None) or {}, f"{path}: simulation.vehicle")


def _write_openscenario(path: Path, folder: Path) -> tuple[str, tuple[str, ...]]:
    """Write the scenario at ``path`` as OpenSCENARIO. Raises `UnisimError`."""
    prepared, vehicle = _prepared(path)
    log = prepared.scenario.log_path
    classes = extras_of(open_log(log)).classes if log.exists() else None
    file = openscenario_writer.write(prepared.scenario.name, prepared.edited, vehicle, classes, folder)
    return file, tuple(losses_of(prepared.scenario, prepared.edited, sensors=True))


def _write_alpasim(path: Path, folder: Path) -> tuple[str, tuple[str, ...]]:
    """Write the scenario at ``path`` for AlpaSim's runtime, as `unisim serve` has it. Raises `UnisimError`."""
    prepared, vehicle = _prepared(path)
    scene = open_served_scene(path, RenderOptions(quality="fast"))
    time_s = scene.drive.time_s[scene.drive.frames[0]]
    heights = scene.renderer.tracer(scene.captures.states.state(time_s, time_s)).heights
    digest = hashlib.sha256(json.dumps(scenario_to_json(prepared.scenario), sort_keys=True).encode()).hexdigest()
    file, losses = alpasim.write(scene, vehicle, heights, digest, folder)
    return file, (*losses_of(prepared.scenario, prepared.edited, sensors=False), *losses)


WRITERS = {
    one.name: one
    for one in (
        ScenarioFormat("alpasim", "a scene for AlpaSim's runtime, which `unisim serve` renders", _write_alpasim),
        ScenarioFormat("openscenario", "ASAM OpenSCENARIO XML 1.3", _write_openscenario),
    )
}
READERS = ("openscenario",)


def write_scenario(path: Path, name: str, out: Path) -> Exchanged:
    """Write the scenario at ``path`` in a format into the folder ``out``, which must be empty or missing.

    Raises `UnisimError`.
    """
    return _into(out, lambda folder: WRITERS[name].write(path, folder))


def read_scenario(path: Path, base: Path, out: Path, actors: Mapping[str, str] | None = None) -> Exchanged:
    """Read an OpenSCENARIO file as the scenario `scenario.json` in the folder ``out``, which must be empty or missing.

    It has the file's edits after those of ``base``, a scenario, a log or a trained scene. ``actors``: the log's actors by
    entities' names, where these are others. Raises `UnisimError`.
    """

    def write(folder: Path) -> tuple[str, tuple[str, ...]]:
        prepared, vehicle = _prepared(base)
        edits, losses = openscenario_reader.read(path, prepared.edited, vehicle, actors or {})
        scenario = rebased(prepared.scenario, Path(os.path.abspath(out)) / SCENARIO_NAME)
        scenario = replace(scenario, edits=(*scenario.edits, *edits), description=f"edits of {path.name}")
        save_scenario(scenario, folder / SCENARIO_NAME)
        return SCENARIO_NAME, losses

    return _into(out, write)


def _into(out: Path, write: Callable[[Path], tuple[str, tuple[str, ...]]]) -> Exchanged:
    """Have a folder written beside ``out`` and renamed to it."""
    out = Path(os.path.abspath(out))
    with hold_folder(out):
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise OutputError(f"{out}: is not empty; name another folder")
        folder = out.with_name(f".{out.name}.unfinished")
        shutil.rmtree(folder, ignore_errors=True)
        try:
            folder.mkdir(parents=True)
            file, losses = write(folder)
            if out.is_dir():
                out.rmdir()
            os.replace(folder, out)
        except OSError as error:
            raise OutputError(f"{out}: cannot be written: {error.strerror}") from error
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    return Exchanged(out / file, losses)
