"""A driver in the closed loop of the scene's scenario, in the background, and on from where a rollout is at; models of
actors in simulations."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import IntProperty, StringProperty

from ...bridge.objects.imported import source_of
from ...bridge.objects.settings import modelled, output_sensors, rollout_folder
from ...bridge.sampling.stepping import frame_of
from ...bridge.window import Need, chosen, drive, folder_on_disk, selected
from ...core.errors import UnisimError
from ...editing.sampled.clock import Clock
from ...editing.simulation import stated
from ...editing.simulation.menus import is_remote, renderer_options
from ...editing.simulation.rollouts import (
    COLUMNS,
    STEPS,
    best_values,
    count_steps,
    in_order,
    listed_rollouts,
    read_rollout,
    scenario_path,
    variant_of,
    write_inputs,
)
from ...editing.texts import translatable
from ...preferences import device, interpreter
from ...process.background import launch
from ...process.tasks import SequenceTask
from ...translations import interface, localized, message, tooltip
from ..drive.export_operators import scenario_steps
from ..operator_bases import AtOnce, Editing, Needing, in_thread, nothing_runs
from ..output.operators import sensor_options, width_options
from .properties import driver_of


class RolloutTask(SequenceTask):
    """A rollout in its folder; ``total`` are its steps. Cancelled and started again, it goes on with the steps that are
    missing."""

    title = translatable("Simulation")
    units, rates = translatable("{done} of {total} steps"), translatable(", {rate:.2f} steps/s")

    @property
    def done(self) -> float:
        return float(count_steps(self.folder))


CELLS = (200, 80, 130, *(94 for _ in COLUMNS), 24)
"""Widths of the cells of the list of rollouts: name, driver, end, a score each, and the cross."""
LIST_WIDTH = sum(CELLS)
HERE_S = 0.011
"""A simulation needs a step of at least 10 ms before the end."""


def rollouts_folder(scene: bpy.types.Scene) -> Path | None:
    """Return the folder that a scene's rollouts are written to; None while it is not known."""
    return folder_on_disk(scene.unisim_simulation.out)


def folder_known(context: bpy.types.Context) -> Need:
    """The folder of rollouts is known."""
    return rollouts_folder(
        context.scene
    ) is not None, "Save the .blend first, or choose a folder for rollouts that does not depend on it"


def driver_named(context: bpy.types.Context) -> Need:
    """The driver is known by its name."""
    return driver_of(context.scene), "Name the driver first: module:function, or its address"


class Simulates(AtOnce):
    """Base of operators that simulate."""

    def start_of(self, scene: bpy.types.Scene) -> float | None:
        """Return up to when a rollout's scene is as driven; None for any other scene, and for one simulated from its
        start."""
        text, begin = scene.unisim_simulation.document, scene.unisim_simulation.span_s[0]
        if rollout_folder(scene) is None or not stated.states(text, "start_s"):
            return None
        start_s = stated.stated_number(text, "start_s")
        return start_s if start_s > begin + 1e-6 else None

    def work(self: Any, context: bpy.types.Context) -> Generator[str | None, None, None]:
        scene = context.scene
        parent, source, about = rollouts_folder(scene), source_of(scene), scene.unisim_simulation
        assert parent is not None  # the button is grey without
        sensors = output_sensors(scene, context.selected_objects, source.drive)
        driver = driver_of(scene)
        command = ["--driver", driver, "--device", device()]
        command += ["--driver-address", about.address.strip()] if is_remote(driver) else []
        command += [*sensor_options(sensors), *renderer_options(about.renderer), *width_options(scene)]
        read = yield from scenario_steps(scene, parent / "scenario.json", self.start_of(scene))
        scenario, scene_name, opened = stated.as_simulated(read), scene.name, rollout_folder(scene)
        if opened is not None and scene_name == opened.name:  # rollouts of rollouts are named alike
            scene_name = variant_of(opened)
        total = stated.count_steps(scenario, source.drive)
        folder = yield from in_thread(lambda: write_inputs(scenario, command, parent, scene_name, driver))
        arguments = ["drive", str(scenario_path(folder)), "--out", str(folder), "--resume", *command]
        task = RolloutTask(arguments, folder, float(total), interpreter())
        about.scored = str(folder)
        launch(task)


class UNISIM_OT_simulate(Needing, Simulates, bpy.types.Operator):
    """Let the driver drive through the scenario, with sensors that answer and actors that react, in the background"""

    bl_label = "Simulate"
    bl_options = {"REGISTER"}
    needs = (drive, driver_named, folder_known, nothing_runs)


def rollout_folders(scene: bpy.types.Scene) -> list[Path]:
    """Return the folders in the folder of a scene's rollouts, without those that the list leaves out, and that of the
    rollout that the scene was opened from."""
    parent, opened = rollouts_folder(scene), rollout_folder(scene)
    hidden = scene.unisim_simulation.hidden.split("/")
    folders = set(parent.iterdir()) if parent is not None and parent.is_dir() else set()
    return [folder for folder in folders | ({opened} if opened else set()) if folder.name not in hidden]


def rollout_there(context: bpy.types.Context) -> Need:
    """There is a rollout to list."""
    scene = context.scene
    listed = any((folder / STEPS).is_file() for folder in rollout_folders(scene))
    return listed or scene.unisim_simulation.hidden, "There is no rollout in the folder yet: simulate first"


def is_rollout(context: bpy.types.Context) -> Need:
    """The scene was opened from a rollout."""
    return context.scene.unisim_simulation.rollout, "Open a rollout first: this scene is none"


def time_now(context: bpy.types.Context) -> float:
    """Return the log's time at the current frame, in seconds."""
    scene = context.scene
    return float(Clock.of(source_of(scene).drive).time_s(np.array(frame_of(scene))))


def within(context: bpy.types.Context) -> Need:
    """The current frame lies in the rollout, before its end."""
    scene = context.scene
    there = False
    if scene.unisim_simulation.rollout and scene.unisim.log:
        begin, end = scene.unisim_simulation.span_s
        try:
            there = begin + 1e-4 < time_now(context) < end - HERE_S
        except (UnisimError, OSError):
            there = False
    return there, "Go to a frame after the start of the rollout and before its end"


class UNISIM_OT_drive_on(Needing, Simulates, bpy.types.Operator):
    """Simulate on from the current frame: as driven until then, with the edits of this scene from then on"""

    bl_label = "Drive On from Here"
    bl_options = {"REGISTER"}
    needs = (drive, is_rollout, within, driver_named, folder_known, nothing_runs)

    def work(self, context: bpy.types.Context) -> Generator[str | None, None, None]:
        """Let the simulation start at the rollout's step next to the current frame and end where it ended, and begin
        it."""
        scene = context.scene
        about, folder, now_s = scene.unisim_simulation, rollout_folder(scene), time_now(context)
        assert folder is not None  # the button is grey without
        rollout = yield from in_thread(lambda: read_rollout(folder))
        about.document = stated.from_time(about.document, rollout.nearest_step(now_s), float(rollout.times_s[-1]))
        bpy.ops.ed.undo_push(message=message("Drive On from Here"))
        yield from super().work(context)


def active_actor(context: bpy.types.Context) -> Need:
    """An actor of the scene is active."""
    obj = context.active_object
    there = obj is not None and obj.unisim.kind == "ACTOR" and obj.name in context.scene.objects
    return there, "Make an actor active first: click it"


class UNISIM_OT_same_model(Editing, bpy.types.Operator):
    """Give the selected actors the model of the active one, with its parameters"""

    bl_label = "Same for Selected"
    needs = (
        drive,
        active_actor,
        selected("Select an actor first", "ACTOR"),
        lambda context: (chosen(context, "ACTOR")[1:], "Select further actors: the active one has this model already"),
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        document, actors = context.active_object.unisim_model.document, chosen(context, "ACTOR")
        for obj in actors:
            obj.unisim_model.document = document
        self.report({"INFO"}, message("Actors with this model: {count}", count=len(actors)))
        return {"FINISHED"}


class UNISIM_OT_forget_model(Editing, bpy.types.Operator):
    """Let the actor move as all others do in simulations"""

    bl_label = "As All Others"
    needs = (drive, lambda context: (modelled(context.scene), "No actor has a model of its own"))

    name: StringProperty(name="Actor", description="The object's name", options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = context.scene.objects.get(self.name)
        if obj is None:
            self.report({"WARNING"}, message('"{name}" is not there any more', name=self.name))
            return {"CANCELLED"}
        obj.unisim_model.document = ""
        return {"FINISHED"}


class UNISIM_OT_hide_rollout(bpy.types.Operator):
    """Leave this rollout out of the list; its folder stays"""

    bl_label = "Remove from List"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Note the name; "" shows all again."""
        about = context.scene.unisim_simulation
        about.hidden = f"{about.hidden}/{self.name}" if self.name else ""
        return {"FINISHED"}


class UNISIM_OT_sort_rollouts(bpy.types.Operator):
    """List the rollouts in the order of this column, the best first"""

    bl_label = "Sort Rollouts"
    bl_options = {"INTERNAL"}

    column: IntProperty(default=-1, options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        return tooltip(COLUMNS[properties.column].about) if properties.column >= 0 else ""

    def execute(self, context: bpy.types.Context) -> set[str]:
        UNISIM_OT_compare_rollouts.sorted_by = self.column
        return {"FINISHED"}


class UNISIM_OT_compare_rollouts(Needing, bpy.types.Operator):
    """List all rollouts in the folder with their scores side by side; the best value of each score has a dot"""

    bl_label = "Compare Rollouts"
    bl_options = {"REGISTER"}
    needs = (drive, rollout_there)
    sorted_by = -1

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_popup(self, width=LIST_WIDTH)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Nothing: the list is what it does."""
        return {"FINISHED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a row for each rollout: a click opens it, the cross takes it off the list."""
        layout, hidden = self.layout, context.scene.unisim_simulation.hidden
        rollouts = in_order(listed_rollouts(rollout_folders(context.scene)), self.sorted_by)
        best, opened = best_values(rollouts), rollout_folder(context.scene)
        row = list_row(layout)
        row[0].operator("unisim.sort_rollouts", text="Rollout", emboss=False)
        for cell, title in zip(row[1:3], ("Driver", "End"), strict=True):
            cell.label(text=title)
        for number, (cell, column) in enumerate(zip(row[3:], COLUMNS, strict=False)):
            pressed = self.sorted_by == number
            cell.operator("unisim.sort_rollouts", text=interface(column.title), depress=pressed).column = number
        for rollout in rollouts:
            row = list_row(layout)
            name = rollout.folder.name
            shown = row[0].operator("unisim.open_rollout", text=name, translate=False, depress=rollout.folder == opened)
            shown.directory = str(rollout.folder)
            row[1].label(text=rollout.driver or "–", translate=False)
            row[2].label(text=localized(rollout.end), translate=False)
            for cell, column, value, top in zip(row[3:], COLUMNS, rollout.values, best, strict=False):
                text = column.text(value)
                cell.label(text=text, translate=False, icon="LAYER_ACTIVE" if text == top else "BLANK1")
            row[-1].operator("unisim.hide_rollout", text="", icon="X", emboss=False).name = name
        if hidden:
            text = interface("Show {count} more", count=hidden.count("/"))
            layout.operator("unisim.hide_rollout", text=text, translate=False, icon="HIDE_OFF")


def list_row(layout: Any) -> list[Any]:
    """Return the cells of a row of the list: name, driver, end, a score each, and the cross."""
    split, left = layout.row(align=True), float(sum(CELLS))
    cells = []
    for width in CELLS[:-1]:
        split = split.split(factor=width / left, align=True)
        cells.append(split.row(align=True))
        left -= width
    return [*cells, split.row(align=True)]
