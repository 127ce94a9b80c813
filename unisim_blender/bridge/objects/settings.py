"""Settings of a scene: its outputs, and how it is simulated: times, seed, and the models of its actors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy

from ...core.errors import UnisimError
from ...core.scenario.simulation import OTHER_ACTORS, SimulationSpec
from ...core.scenario.types import Scenario
from ...core.world.captures import CaptureKey
from ...core.world.drive import Drive
from ...editing.reading.scenario import moment_keys, names_captures
from ...editing.sensors.names import sensor_name
from ...editing.simulation.stated import actors_texts, ids_of, simulation_of, simulation_text
from .imported import imported_objects, originals, title_of


def captures_stated(scene: bpy.types.Scene) -> bool:
    """Return whether the frames or times that the imported scenario stated hold: until the frame range is changed."""
    about = scene.unisim
    now = (scene.frame_start, scene.frame_end, scene.frame_step)
    return names_captures(about.stated) and tuple(about.stated_range) == now


def rendered_keys(scene: bpy.types.Scene, scenario: Scenario, drive: Drive) -> set[CaptureKey]:
    """Return the keys of the moments that rendering a scene's scenario makes. Raises `ScenarioError`."""
    frames = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    if captures_stated(scene) and isinstance(scenario.frames, tuple):
        return moment_keys(scenario, drive, scenario.frames)
    return moment_keys(scenario, drive, frames)


def output_sensors(scene: bpy.types.Scene, selected: list[bpy.types.Object], drive: Drive) -> list[str] | None:
    """Return the names of the sensors that a sequence renders; None for all of them.

    Raises `UnisimError` where the choice leaves none.
    """
    chosen = scene.unisim.sequence_sensors
    if chosen == "ALL":
        return None
    if chosen == "CAMERA":
        sensors = [scene.camera] if scene.camera is not None and scene.camera.unisim.kind == "CAMERA" else []
        lacking = (
            "the active camera is no camera of the vehicle: select one and press Ctrl-Numpad 0, or choose All Sensors"
        )
    else:
        sensors = [obj for obj in selected if obj.unisim.kind in ("CAMERA", "LIDAR")]
        lacking = "no camera or LiDAR is selected: select some, or choose All Sensors"
    if not sensors:
        raise UnisimError(f"Output > Sensors: {lacking}")
    return [sensor_name(title_of(obj), obj.unisim.uid, obj.name == obj.unisim.home, drive) for obj in sensors]


def models_of(scene: bpy.types.Scene) -> dict[str, str]:
    """Return the models of a scene's actors as texts, by the ids that a scenario has for them, and that of all others."""
    models = {OTHER_ACTORS: scene.unisim_simulation.others.document}
    return models | {uid: obj.unisim_model.document for uid, obj in by_scenario_id(scene) if obj.unisim_model.document}


def modelled(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the actors that have a model of their own, by name."""
    return [obj for obj in imported_objects(scene, "ACTOR") if obj.unisim_model.document]


def by_scenario_id(scene: bpy.types.Scene) -> list[tuple[str, bpy.types.Object]]:
    """Return the actors' objects with the ids that a scenario has for them: see `imported.original_of`."""
    known = originals(scene, "ACTOR")
    return [
        (obj.unisim.uid if known.get(obj.unisim.uid) == obj else title_of(obj), obj)
        for obj in imported_objects(scene, "ACTOR")
    ]


def with_simulation(scenario: Scenario, text: str, models: dict[str, str], recorded: Drive) -> Scenario:
    """Return a scenario with a simulation and models of those of its actors that there are. Raises `ScenarioError`."""
    spec = simulation_of(text, models, ids_of(scenario.edits, recorded.actors))
    return scenario if spec is None else replace(scenario, simulation=spec)


def apply_simulation(scene: bpy.types.Scene, spec: SimulationSpec | None) -> None:
    """Let a scene be simulated as a scenario states it. Models of actors that are not there stay as
    they are stated."""
    about, texts = scene.unisim_simulation, actors_texts(spec)
    about.others.document = texts.pop(OTHER_ACTORS, "")
    for uid, obj in by_scenario_id(scene):
        obj.unisim_model.document = texts.pop(uid, "")
    remaining = None if spec is None else replace(spec, actors={uid: (spec.actors or {})[uid] for uid in texts} or None)
    about.document = simulation_text(remaining)


def rollout_folder(scene: bpy.types.Scene) -> Path | None:
    """Return the folder of the rollout that a scene was opened from; None for any other scene."""
    folder = scene.unisim_simulation.rollout
    return Path(bpy.path.abspath(folder)) if folder else None
