"""Lamps of actors: found in the log's images in the background, shown with their recorded states, and set to others."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
from bpy.props import CollectionProperty, EnumProperty, StringProperty

from ...bridge.objects.imported import source_of
from ...bridge.objects.lamps import SETTINGS, lamp_id, put_lamps
from ...bridge.window import drive, object_mode, redraw
from ...core.errors import UnisimError
from ...editing.readers.lamps import lamp_text
from ...editing.sampled.source import lamps_of
from ...editing.texts import Text, series, translatable
from ...preferences import interpreter
from ...process.background import launch
from ...process.tasks import ShareTask
from ...translations import interface, localized, message
from ..operator_bases import Needing, nothing_runs, reporting
from ..problems import draw_problem
from ..sidebar import DrivePanel, draw_task


class UniSimLamp(bpy.types.PropertyGroup):
    """A lamp of an actor, or several that change together; ``name`` is its colour and side, "" where they are not known yet"""

    actor: StringProperty(description="Identifier of the actor in scenarios")
    recorded: StringProperty(
        description="States that the log shows, and from when on, as JSON; empty before the search"
    )
    # a .blend file holds these by their places
    state: EnumProperty(
        name="State",
        description="State in which images show the lamp; keys animate it",
        items=[(state, state.capitalize(), "") for state in SETTINGS],
    )


class LampTask(ShareTask):
    """Lamps found in the images of a log."""

    title = translatable("Finding lamps")
    entry = "lamps"

    def finish(self) -> None:
        """Put the lamps into the scene that asked for them."""
        scene = bpy.data.scenes.get(self.scene)
        if self.code == 0 and scene is not None:
            put_lamps(scene, lamps_of(source_of(scene), again=True) or {})
            if not bpy.app.background:
                bpy.ops.ed.undo_push(message="Find Lamps")
            redraw("VIEW_3D")


class UNISIM_OT_find_lamps(Needing, bpy.types.Operator):
    """Find traffic lights, brake lamps and indicators that change in the images of the log, in the background"""

    bl_label = "Find Lamps"
    bl_options = {"REGISTER"}
    needs = (object_mode, drive, nothing_runs)

    @reporting
    def execute(self, context: bpy.types.Context) -> set[str]:
        source = source_of(context.scene)
        if source.log is None:
            raise UnisimError(message("{log}: is not at hand, and lamps are found in its images", log=source.log_path))
        launch(LampTask([str(source.log_path), str(source.scene_path or "")], Path(), 100.0, interpreter()))
        return {"FINISHED"}


class UNISIM_PT_lamps(DrivePanel, bpy.types.Panel):
    """Lamps of the active actor, and the states that the log shows them in; keys animate what images show"""

    bl_label = "Lamps"
    bl_parent_id = "UNISIM_PT_actor"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj, scene = self.layout, context.active_object, context.scene
        layout.operator("unisim.find_lamps", icon="VIEWZOOM")
        draw_task(layout, scene, LampTask)
        lamps = [lamp for lamp in scene.unisim_lamps if obj is not None and lamp.actor == lamp_id(obj)]
        for lamp in lamps:
            box, recorded = layout.box(), json.loads(lamp.recorded or "[]")
            box.label(text=localized(lamp_text(lamp.name)), translate=False, icon="LIGHT")
            row, known = box.row(align=True), {state for state, _ in recorded} or {"off", "on"}
            for state in SETTINGS:
                if state in {"recorded", lamp.state, *known}:
                    row.prop_enum(lamp, "state", state)
            row.prop_decorator(lamp, "state")
            spans = [Text("{state} from {time:.1f} s", state=Text(a.capitalize()), time=at) for a, at in recorded[1:]]
            spans = [Text(state.capitalize()) for state, _ in recorded[:1]] + spans
            draw_problem(box, localized(series(spans)) if spans else interface("Not searched yet"))
        if not lamps:
            layout.label(text="No lamp found")


PROPERTIES = ((bpy.types.Scene, "unisim_lamps", CollectionProperty(type=UniSimLamp)),)
