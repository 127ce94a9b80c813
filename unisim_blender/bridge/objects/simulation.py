"""How a scene is simulated, read off its properties and put into them: times, seed, and the models of its actors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy

from ...core.scenario.simulation.document import OTHERS, SimulationSpec
from ...core.scenario.types import Scenario
from ...core.world.drive import Drive
from ...editing.simulation.stated import actors_texts, ids_of, simulation_of, simulation_text
from .imported import imported_objects, original_of, title_of


def models_of(scene: bpy.types.Scene) -> dict[str, str]:
    """Return the models of a scene's actors as texts, by the ids that a scenario has for them, and that of all others."""
    found = {OTHERS: scene.unisim_simulation.others.document}
    for obj in imported_objects(scene, "ACTOR"):
        if obj.unisim_model.document:
            found[scenario_id(scene, obj)] = obj.unisim_model.document
    return found


def modelled(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the actors that have a model of their own, by name."""
    return [obj for obj in imported_objects(scene, "ACTOR") if obj.unisim_model.document]


def scenario_id(scene: bpy.types.Scene, obj: bpy.types.Object) -> str:
    """Return the id that a scenario has for an actor's object."""
    uid = str(obj.unisim.uid)
    return uid if uid and original_of(scene, "ACTOR", uid) == obj else title_of(obj)


def with_simulation(scenario: Scenario, text: str, models: dict[str, str], recorded: Drive) -> Scenario:
    """Return a scenario with a simulation and models of those of its actors that there are. Raises `ScenarioError`."""
    spec = simulation_of(text, models, ids_of(scenario.edits, recorded.actors))
    return scenario if spec is None else replace(scenario, simulation=spec)


def apply_simulation(scene: bpy.types.Scene, spec: SimulationSpec | None) -> None:
    """Let a scene be simulated as a scenario states it. Models of actors that are not there are kept as they are stated."""
    about, texts = scene.unisim_simulation, actors_texts(spec)
    about.others.document = texts.pop(OTHERS, "")
    for obj in imported_objects(scene, "ACTOR"):
        obj.unisim_model.document = texts.pop(scenario_id(scene, obj), "")
    kept = None if spec is None else replace(spec, actors={uid: (spec.actors or {})[uid] for uid in texts} or None)
    about.document = simulation_text(kept)


def rollout_folder(scene: bpy.types.Scene) -> Path | None:
    """Return the folder of the rollout that a scene was opened from; None for any other scene."""
    folder = scene.unisim_simulation.rollout
    return Path(bpy.path.abspath(folder)) if folder else None
