"""Panel Simulate: what drives, how actors move, and the scores of the newest rollout."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import bpy

from ...bridge.objects.settings import modelled
from ...bridge.views.rollouts import actor_names
from ...core.errors import UnisimError
from ...editing.simulation import stated
from ...editing.simulation.menus import OWN, is_remote
from ...editing.simulation.rollouts import SCORES, ScoreRow, read_scores, score_rows
from ...translations import interface, localized
from ..sidebar import DrivePanel, draw_task, optional_row, settings_column
from .operators import RolloutTask, active_actor
from .properties import KINDS

MOST = 20
"""Actors with models of their own that are listed at once."""
_scores: dict[str, tuple[float, Mapping[str, Any] | None]] = {}
"""The newest scores by folder, with the time of the file's change."""


class UNISIM_PT_simulation(DrivePanel, bpy.types.Panel):
    """A driver in the closed loop"""

    bl_label = "Simulate"
    bl_order = 1
    tasks = ("SIMULATE",)

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        about = scene.unisim_simulation
        column = settings_column(layout)
        column.prop(about, "choice")
        remote = is_remote(about.choice)
        row = column.row()
        row.enabled = remote or about.choice == OWN
        row.prop(about, "address" if remote else "function")
        optional_row(column, "Start at", "The first frame", about, "starts", "start_s")
        optional_row(column, "Duration", "To the last frame", about, "ends", "duration_s")
        column.prop(about, "step_s")
        column.prop(about, "delay_s")
        column.prop(about, "seed")
        hidden = stated.hidden_members(about.document)
        if hidden:
            layout.label(text=interface("Kept as imported: {names}", names=", ".join(hidden)), translate=False)
        column = settings_column(layout)
        column.prop(about, "renderer")
        column.prop(scene.unisim, "quality")
        column.prop(scene.unisim, "sequence_sensors")
        optional_row(column, "Width", "Each camera's own", scene.unisim, "has_sequence_width", "sequence_width")
        column.prop(about, "out")
        column = layout.column(align=True)
        column.operator("unisim.simulate", icon="PLAY")
        column.operator("unisim.drive_on", icon="TRACKING_FORWARDS_SINGLE")
        draw_task(layout, scene, RolloutTask)


class UNISIM_PT_random_starts(DrivePanel, bpy.types.Panel):
    """Largest distances of starts from the recorded ones, which the seed draws"""

    bl_label = "Random Starts"
    bl_parent_id = "UNISIM_PT_simulation"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        column = settings_column(self.layout)
        for name in ("jitter_along", "jitter_aside", "jitter_yaw", "jitter_speed", "jitter_actors"):
            column.prop(context.scene.unisim_simulation, name)


class UNISIM_PT_simulated_actors(DrivePanel, bpy.types.Panel):
    """Models of actors in simulations"""

    bl_label = "Actors in Simulations"
    bl_order = 1
    bl_parent_id = "UNISIM_PT_simulation"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the model of all others, the actors that have one of their own, and last what depends on the selection."""
        layout, scene = self.layout, context.scene
        others = scene.unisim_simulation.others
        column = settings_column(layout)
        column.prop(others, "kind_of_others")
        draw_parameters(column, others)
        actors = modelled(scene)
        column = layout.column(align=True)
        for actor in actors[:MOST]:
            row = column.row(align=True)
            there = row.operator("unisim.choose_actor", text=actor.name, translate=False)
            there.name = actor.name
            titles = {name: title for name, title, _ in KINDS}
            kind = stated.kind_of(actor.unisim_model.document)
            row.label(text=titles.get(kind, kind))
            row.operator("unisim.forget_model", text="", icon="X").name = actor.name
        if len(actors) > MOST:
            column.label(text=interface("And {count} more", count=len(actors) - MOST), translate=False)
        obj, box = context.active_object, layout.box()
        box.operator("unisim.same_model", icon="COPYDOWN")
        if not active_actor(context)[0]:
            box.label(text="No active actor", icon="OBJECT_DATA")
            return
        box.label(text=obj.name, translate=False, icon="OBJECT_DATA")
        column = settings_column(box)
        column.prop(obj.unisim_model, "kind")
        if obj.unisim_model.document:
            draw_parameters(column, obj.unisim_model)


def draw_parameters(column: bpy.types.UILayout, model: bpy.types.PropertyGroup) -> None:
    """Draw the parameters of a model."""
    kind = stated.kind_of(model.document)
    for member in stated.numbers_of(kind):
        if hasattr(model, member):
            column.prop(model, member)
    if kind == "scripted":
        column.prop(model, "keys")


class UNISIM_PT_scores(DrivePanel, bpy.types.Panel):
    """The scores of the newest rollout, or of the one that was opened"""

    bl_label = "Scores"
    bl_parent_id = "UNISIM_PT_simulation"

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        about = scene.unisim_simulation
        folder = Path(bpy.path.abspath(about.scored)) if about.scored else None
        column = settings_column(layout)
        column.operator("unisim.open_rollout", icon="IMPORT").directory = str(folder or "")
        column.operator("unisim.compare_rollouts", icon="SPREADSHEET")
        shown = column.column()
        shown.enabled = bool(about.rollout)
        shown.prop(about, "show_plans")
        shown.prop(about, "show_ghost")
        if folder is None:
            layout.label(text="No rollout yet", icon="BLANK1")
        else:
            layout.label(text=folder.name, translate=False, icon="FILE_FOLDER")
            draw_scores(layout, rows_of(scene, folder))


def draw_scores(layout: bpy.types.UILayout, rows: list[ScoreRow] | None) -> None:
    """Draw rows of scores; None where there are none yet."""
    if rows is None:
        layout.label(text="Not scored yet", icon="BLANK1")
        return
    column = layout.column(align=True)
    for name, value, warns in rows:
        split = column.split(factor=0.42)
        split.label(text=localized(interface(name) if type(name) is str else name), translate=False)
        row = split.row()
        row.alert = warns
        row.label(text=localized(value), translate=False)


def rows_of(scene: bpy.types.Scene, folder: Path) -> list[ScoreRow] | None:
    """Return the rows of a rollout's scores; None until it has some. The file is read when it changes."""
    try:
        changed = (folder / SCORES).stat().st_mtime
    except OSError:
        return None
    known = _scores.get(str(folder))
    if known is None or known[0] != changed:
        try:
            known = changed, read_scores(folder)
        except UnisimError:
            known = changed, None
        _scores.clear()
        _scores[str(folder)] = known
    return None if known[1] is None else score_rows(known[1], actor_names(scene))
