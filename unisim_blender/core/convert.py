"""Converts logs to other layouts, and scenarios to and from other formats.

All is written to a hidden folder beside ``out``, which is renamed to it at the end. An interrupted conversion of a log leaves
that folder; the same conversion, begun again, writes the parts that are not there yet. `conversion.json` says what was
converted, and how.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from .data.log import Log, extras_of, log_digest
from .errors import LogError, OutputError, refused
from .files import hold_folder, remove_partial_files, write_file
from .formats.alpasim import write as alpasim
from .formats.common.writer import SCRATCH, LogWriter, WritePlan
from .formats.openscenario import read as openscenario_reader
from .formats.openscenario import write as openscenario_writer
from .formats.readers import open_log
from .formats.rendered import RenderedLog, is_rendered
from .json_file import Node, json_bytes, read_json
from .prepare.scenario import PreparedScenario, prepare_scenario
from .prepare.scenario_plan import RenderOptions
from .scenario import rebased, save_scenario, scenario_to_json
from .scenario.types import Scenario
from .serve.scenes import open_served_scene
from .simulation.rollout.steps import SCENARIO_NAME
from .simulation.vehicle.parameters import Vehicle
from .world.drive import Drive
from .world.drive_json import drive_to_json


@dataclass(frozen=True)
class ConvertSource:
    """A drive to convert; ``digest`` is the same wherever its files lie, and another one when they change."""

    log: Log
    digest: str


def open_source(path: Path | str, posed: Callable[[Log], Log] | None = None) -> ConvertSource:
    """Open a log or a rendered folder; ``posed`` returns the log with the poses to write. Raises `LogError`."""
    path = Path(path)
    if not path.exists():
        raise LogError(f"{path}: there is no such log, and nothing that was rendered")
    log: Log
    if is_rendered(path):
        log = rendered = RenderedLog(path)
        files = rendered.content
    else:
        log = open_log(path)
        files = log_digest(log)
        log = log if posed is None else posed(log)
    digest = hashlib.sha256(files.encode())
    # of a log that is named by one of its files, the other files' poses and boxes
    digest.update(json_bytes(drive_to_json(log.drive)))
    return ConvertSource(log, digest.hexdigest())


STATE_NAME = "conversion.json"
FORMAT, VERSION = "unisim-conversion", 1


@dataclass(frozen=True)
class Converted:
    """Result of a conversion: captures written by this run, those that were there, the layout's ``losses``, and the
    path that `open_log` opens. ``was_there``: an earlier run had finished it."""

    written: int
    reused: int
    losses: tuple[str, ...]
    opens: Path
    was_there: bool = False


def unfinished_folder(out: Path) -> Path:
    """Return where a conversion to ``out`` is written until it is finished."""
    return out.with_name(f".{out.name}.unfinished")


def convert(
    source: ConvertSource,
    writer: LogWriter,
    out: Path,
    on_start: Callable[[int, tuple[str, ...]], None] = lambda captures, losses: None,
    on_reused: Callable[[int], None] = lambda captures: None,
    on_capture: Callable[[], None] = lambda: None,
) -> Converted:
    """Write a source's drive as a log in the folder ``out``.

    ``on_start`` is called once with the number of captures and what the layout loses, ``on_reused`` with the number of captures
    of each part that was there, ``on_capture`` after each that is written. A conversion of the same source that was finished
    before is left as it is. Raises `OutputError`, `LogError`; what was written stays, to go on from.
    """
    out = Path(os.path.abspath(out))
    about = {
        "format": FORMAT,
        "version": VERSION,
        "to": writer.name,
        "writer_version": writer.version,
        "source": {"name": source.log.drive.name, "digest": source.digest},
    }
    if out.exists():
        if not out.is_dir():
            raise OutputError(f"{out}: is no folder")
        if any(out.iterdir()):
            _check_same(out, about)
            finished = Node(read_json(out / STATE_NAME, OutputError), f"{out / STATE_NAME}: ", OutputError)
            losses = tuple(node.text() for node in finished.key("losses").elements())
            captures, opens = finished.key("captures").integer(at_least=1), finished.key("opens").text()
            return Converted(0, captures, losses, out / opens, was_there=True)
    with hold_folder(unfinished_folder(out)):
        return _convert(source, writer, out, about, (on_start, on_reused, on_capture))


def _convert(
    source: ConvertSource,
    writer: LogWriter,
    out: Path,
    about: dict[str, Any],
    on: tuple[Callable[[int, tuple[str, ...]], None], Callable[[int], None], Callable[[], None]],
) -> Converted:
    """Write what is not there yet into the unfinished folder, and rename it to ``out``."""
    folder, (on_start, on_reused, on_capture) = unfinished_folder(out), on
    if begun := folder.is_dir() and any(folder.iterdir()):
        _check_same(folder, about)
        remove_partial_files(folder)
    try:
        plan = writer.plan(source.log, folder)
        captures = sum(part.captures for part in plan.parts)
        if not captures:
            raise OutputError(f"{source.log.path}: has neither images nor sweeps to convert")
    except BaseException:
        if not begun:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    said = {"captures": captures, "losses": list(plan.losses), "opens": plan.opens}
    write_file(folder / STATE_NAME, json_bytes({**about, **said}))
    on_start(captures, plan.losses)
    written, reused = _write_parts(plan, folder, on_reused, on_capture)
    plan.finish()
    shutil.rmtree(folder / SCRATCH, ignore_errors=True)
    with refused(out, "written", OutputError):
        if out.is_dir():
            out.rmdir()
        os.replace(folder, out)
    return Converted(written, reused, plan.losses, out / plan.opens)


def _write_parts(
    plan: WritePlan, folder: Path, on_reused: Callable[[int], None], on_capture: Callable[[], None]
) -> tuple[int, int]:
    written = reused = 0
    for part in plan.parts:
        if all((folder / name).is_file() for name in part.files):
            reused += part.captures
            on_reused(part.captures)
        else:
            part.write(on_capture)
            written += part.captures
    return written, reused


def _state(folder: Path) -> dict[str, Any] | None:
    """Return the state of the conversion that a folder records; None where it records none."""
    try:
        state = json.loads((folder / STATE_NAME).read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return state if isinstance(state, dict) and state.get("format") == FORMAT else None


def _check_same(folder: Path, about: dict[str, Any]) -> None:
    state = _state(folder)
    if state is None:
        raise OutputError(f"{folder}: is not empty, and holds no conversion; name another folder")
    if any(state.get(name) != value for name, value in about.items()):
        source = state.get("source")
        name = source.get("name") if isinstance(source, dict) else None
        raise OutputError(
            f"{folder}: holds another conversion, of {str(name)!r:.80} to {str(state.get('to'))!r:.20} or by another version; "
            "remove it, or name another folder"
        )


MAX_NAMED = 5


def losses_of(scenario: Scenario, drive: Drive, sensors: bool) -> list[str]:
    """Return a sentence for each part of a scenario, and of its edited drive, that a format without appearances leaves out;
    ``sensors``: whether it has none for sensors either."""
    losses = []
    foreign = [uid for uid, actor in drive.actors.items() if actor.appearance.mesh or actor.appearance.scene]
    if foreign:
        losses.append(f"where {named(foreign)} look as they do: meshes and other scenes' actors are not written")
    if any(actor.is_ego_body for actor in drive.actors.values()):
        losses.append("the ego vehicle's body: its mesh is not written")
    if drive.static_copies or len(drive.static_removals):
        losses.append("copied and removed boxes of the static world are not written")
    if sensors and scenario.sensors is not None:
        losses.append("the scenario's sensors are not written")
    if scenario.simulation is not None and scenario.simulation.actors:
        losses.append("the actors' models of simulation.actors are not written: they go as the edits have them")
    return losses


def named(names: list[str]) -> str:
    """Return names in a sentence, the first few where there are many."""
    shown = ", ".join(names[:MAX_NAMED])
    return shown if len(names) <= MAX_NAMED else f"{shown} and {len(names) - MAX_NAMED} more"


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
    form.name: form
    for form in (
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
            with refused(out, "written", OutputError):
                folder.mkdir(parents=True)
                file, losses = write(folder)
                if out.is_dir():
                    out.rmdir()
                os.replace(folder, out)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    return Exchanged(out / file, losses)
