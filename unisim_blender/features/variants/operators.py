"""Variants of a scenario: made, named, shown, deleted, compared, rendered together, exported."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
from bpy.props import StringProperty

from ...bridge.changes.variants import delete_variant, new_variant, rename_variant, show_variant, variants_of
from ...bridge.objects.imported import source_of
from ...bridge.objects.settings import output_sensors, rendered_keys
from ...bridge.sampling.edit_list import mark_all
from ...bridge.window import Need, drive, object_mode, redraw
from ...core.errors import UnisimError
from ...core.sequence.records import finished_moments
from ...core.world.captures import CaptureKey
from ...editing.edits.variants import file_names, free_variant_name
from ...editing.reading.scenario import write_scenario
from ...editing.texts import translatable
from ...preferences import interpreter
from ...process.background import launch
from ...process.tasks import SequenceTask, newest_image
from ...translations import message
from ..drive.export_operators import scenario_steps
from ..operator_bases import AtOnce, Editing, InSteps, Needing, nothing_runs, reporting
from ..output.operators import SCENARIO, output_folder, render_arguments


@dataclass(frozen=True)
class VariantRun:
    """One variant: its name, the command's arguments, its folder, and the frames that it has."""

    name: str
    arguments: list[str]
    folder: Path
    wanted: set[CaptureKey]

    @property
    def done(self) -> int:
        """Frames that are finished."""
        return finished_moments(self.folder, self.wanted)


class VariantsTask(SequenceTask):
    """The sequences of several variants. Cancelled and started again, it goes on with the frames that are missing."""

    title = translatable("Variants")
    of_scene = False

    def __init__(self, parts: list[VariantRun], folder: Path, chosen: str) -> None:
        super().__init__([], folder, float(sum(len(part.wanted) for part in parts)), chosen)
        self.parts = parts
        self.at = 0
        """The variant that is being rendered."""

    @property
    def done(self) -> float:
        return float(sum(part.done for part in self.parts))

    @property
    def problem(self) -> str:
        problem = super().problem
        return f"{self.parts[self.at].name}: {problem}" if problem else ""

    def measure(self) -> str:
        part = self.parts[self.at]
        whole = super().measure()
        if not self.running and not self.cancelled:
            return message("{frames} of {count} variants", frames=whole, count=len(self.parts))
        return message(
            "{name} ({number} of {count}): {done} of {total}; {frames} in all",
            name=part.name, number=self.at + 1, count=len(self.parts), done=part.done, total=len(part.wanted),
            frames=whole,
        )  # fmt: skip

    def newest(self) -> Path | None:
        return newest_image(self.parts[self.at].folder)

    def _do(self) -> int:
        code = 0
        for at, part in enumerate(self.parts):
            self.at = at
            code = self._call(part.arguments)
            if code or self.cancelled:
                break
        return code


def marked_variants(scene: bpy.types.Scene) -> list[bpy.types.Scene]:
    """Return the variants that are marked in the list of variants."""
    return [variant for variant in variants_of(scene) if variant.unisim_edits.rendered] if scene.unisim.log else []


def variant_marked(context: bpy.types.Context) -> Need:
    """A variant is marked."""
    return marked_variants(context.scene), "Mark a variant in the list first"


class _Named(Editing):
    """An operator that asks for a variant's name."""

    needs = (object_mode, drive)

    name: StringProperty(name="Name", description="Name of the variant", options={"SKIP_SAVE"})

    def invoke(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.name = self.name or self.proposed(context)
        return context.window_manager.invoke_props_dialog(self)

    @reporting
    def execute(self: Any, context: bpy.types.Context) -> set[str]:
        self.do(context, self.name or self.proposed(context))
        return {"FINISHED"}


class UNISIM_OT_new_variant(_Named, bpy.types.Operator):
    """Copy the scene as a new, independent variant of the scenario and show it"""

    bl_label = "New Variant"

    def proposed(self, context: bpy.types.Context) -> str:
        return free_variant_name("Variant 2", bpy.data.scenes)

    def do(self, context: bpy.types.Context, name: str) -> None:
        variant = new_variant(context.window, context.scene, name)
        self.report({"INFO"}, message("{name} is shown now; edits here do not change the others", name=variant.name))


class UNISIM_OT_rename_variant(_Named, bpy.types.Operator):
    """Rename the shown variant"""

    bl_label = "Rename Variant"

    def proposed(self, context: bpy.types.Context) -> str:
        return context.scene.name

    def do(self, context: bpy.types.Context, name: str) -> None:
        manager, before = context.window_manager, context.scene.name
        rename_variant(context.scene, name)
        if manager.unisim_compared == before:
            manager.unisim_compared = context.scene.name


class UNISIM_OT_delete_variant(Editing, bpy.types.Operator):
    """Delete the shown variant with all its objects and keyframes, and show another one"""

    bl_label = "Delete Variant"
    needs = (
        object_mode,
        drive,
        lambda context: (variants_of(context.scene)[1:], "This is the only variant: revert its edits instead"),
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        question = message("Delete {name} with its objects and keyframes?", name=context.scene.name)
        return context.window_manager.invoke_confirm(self, event, message=question)

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        name = context.scene.name
        now = delete_variant(context.scene)
        mark_all()
        self.report({"INFO"}, message("{name} is deleted; {other} is shown", name=name, other=now.name))
        return {"FINISHED"}


# an undo step, so that the panel of the last operation does not offer to change one of another variant
class UNISIM_OT_show_variant(Editing, bpy.types.Operator):
    """Show this variant, at the same frame"""

    bl_label = "Show Variant"
    needs = (object_mode,)

    name: StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = bpy.data.scenes.get(self.name)
        if scene is None:
            raise UnisimError(message("{name}: there is no such variant any more", name=self.name))
        show_variant(context.window, scene)
        redraw("VIEW_3D")
        return {"FINISHED"}


class UNISIM_OT_compare_variant(bpy.types.Operator):
    """Compare the edits of this variant with those of the shown variant, or end the comparison"""

    bl_label = "Compare with Shown Variant"
    bl_options = {"REGISTER"}

    name: StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        manager = context.window_manager
        manager.unisim_compared = "" if manager.unisim_compared == self.name else self.name
        redraw("VIEW_3D")
        return {"FINISHED"}


class UNISIM_OT_export_variants(Needing, InSteps, bpy.types.Operator):
    """Write every variant as a scenario file into a folder"""

    bl_label = "Export Variants"
    bl_options = {"REGISTER"}
    needs = (drive,)

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    invoke = InSteps.ask_for_path

    def work(self, context: bpy.types.Context) -> Generator[str | None, None, None]:
        """Read all, then write all, so that no half of them is written where one cannot be read."""
        folder = Path(bpy.path.abspath(self.directory)).absolute()
        scenes = variants_of(context.scene)
        names, read = file_names(scene.name for scene in scenes), []
        for scene in scenes:
            path = folder / f"{names[scene.name]}.json"
            read.append(((yield from scenario_steps(scene, path)), path))
        folder.mkdir(parents=True, exist_ok=True)
        for scenario, path in read:
            write_scenario(scenario, path)
        self.report({"INFO"}, message("Scenarios written to {folder}: {count}", count=len(read), folder=folder))


class UNISIM_OT_render_variants(Needing, AtOnce, bpy.types.Operator):
    """Render the marked variants one after another."""

    bl_label = "Render Variants"
    bl_description = (
        "Render the marked variants one after another, each into its own folder in the output folder; "
        "finished frames are kept"
    )
    bl_options = {"REGISTER"}
    needs = (drive, variant_marked, nothing_runs)

    def work(self, context: bpy.types.Context) -> Generator[str | None, None, None]:
        root = output_folder(context.scene)
        names, parts = file_names(scene.name for scene in variants_of(context.scene)), []
        for scene in marked_variants(context.scene):
            folder = root / names[scene.name]
            folder.mkdir(parents=True, exist_ok=True)
            scenario = yield from scenario_steps(scene, folder / SCENARIO)
            write_scenario(scenario, folder / SCENARIO)
            selected = [obj for obj in scene.objects if obj.select_get(view_layer=scene.view_layers[0])]
            arguments = render_arguments(scene, folder, output_sensors(scene, selected, source_of(scene).drive))
            keys = rendered_keys(scene, scenario, source_of(scene).drive)
            parts.append(VariantRun(scene.name, arguments, folder, keys))
        launch(VariantsTask(parts, root, interpreter()))
