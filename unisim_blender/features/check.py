"""The check of the edits: findings that are not plausible, as a list that is saved with the scene, and their panel."""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import replace

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.props import FloatVectorProperty, IntProperty, StringProperty

from ..bridge.changes.following import dragging
from ..bridge.objects.imported import source_of
from ..bridge.sampling.edit_state import edit_state
from ..bridge.window import choose, drive, redraw, run_soon
from ..core.world.drive import Drive
from ..editing.motion.kinematics import Limits
from ..editing.motion.plausibility import Finding, place_of, shadow_note, warnings_of
from ..editing.motion.retiming import instant_of
from ..editing.reading.scenario import unreadable_actors
from ..editing.sampled.clock import Clock
from ..editing.sampled.scene import Sampled
from ..editing.texts import UPPER, Text, cased, packed, unpacked
from ..translations import interface, localized, message
from .drive.export_operators import sampled_in_steps
from .motion.properties import limits_of
from .operator_bases import AtOnce, Editing, in_thread
from .problems import draw_problem
from .sidebar import DrivePanel

SETTLE_S = 0.5
"""From a change of the scene to the comparison with the state that was checked."""

_outdated: dict[int, bool] = {}
"""Scenes, by session_uid, and whether their edits changed since the check."""


def is_outdated(scene: bpy.types.Scene) -> bool:
    """Return whether a scene's edits changed since they were checked, as far as is known."""
    return _outdated.get(scene.session_uid, False)


def compare() -> float | None:
    """Compare every checked scene's edits with the state that was checked; a timer of Blender's, once."""
    if bpy.app.is_job_running("RENDER") or dragging():
        return SETTLE_S
    for scene in bpy.data.scenes:
        if scene.unisim_check.state:
            _outdated[scene.session_uid] = edit_state(scene) != scene.unisim_check.state
    redraw("VIEW_3D")
    return None


@persistent
def compare_soon(scene: bpy.types.Scene | None = None, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Something changed: have a timer compare."""
    if isinstance(scene, bpy.types.Scene) and not scene.unisim_check.state:
        return
    run_soon(compare, SETTLE_S, persistent=True)


@persistent
def compare_all(*_: object) -> None:
    """Another file, or another state of this one: what was known is of other scenes."""
    _outdated.clear()
    compare_soon()


def findings_of(sampled: Sampled, drive: Drive, limits: Limits, is_trained: bool) -> list[Finding]:
    """Return what is not plausible, and before that which actors cannot be read."""
    first = int(sampled.clock.frames[0])
    unreadable = unreadable_actors(sampled, drive)
    lacking = [
        Finding(name, first, Text("{fault}; views leave it out, and nothing can be exported or rendered", fault=why))
        for name, why in unreadable.items()
    ]
    readable = replace(sampled, objects=tuple(obj for obj in sampled.objects if obj.name not in unreadable))
    return [*lacking, *warnings_of(readable, drive, limits, is_trained)]


class UNISIM_OT_check(Editing, AtOnce, bpy.types.Operator):
    """List implausible edits: overlaps, sideways or too fast cars, actors off the ground, far or unseen camera views"""

    bl_label = "Check Edits"
    needs = (drive,)

    def finished(self, context: bpy.types.Context) -> None:
        """Draw the panel again: after a tick of a timer Blender draws none by itself."""
        redraw("VIEW_3D")

    def work(self, context: bpy.types.Context) -> Generator[str | None, None, None]:
        """Sample the scene and list what is odd; nothing is kept from being rendered."""
        scene, check = context.scene, context.scene.unisim_check
        source = source_of(scene)
        drive, is_trained = source.drive, source.scene_path is not None
        clock, limits = Clock.of(drive), limits_of(scene)
        sampled = yield from sampled_in_steps(scene, clock)
        warnings = yield from in_thread(lambda: findings_of(sampled, drive, limits, is_trained))
        note = shadow_note(sampled, drive, is_trained)
        check.shadows.text, check.shadows.text_parts = note, packed(note)
        check.warnings.clear()
        for warning in warnings:
            item = check.warnings.add()
            item.name, item.frame = warning.name, warning.frame
            item.text, item.text_parts = warning.text, packed(warning.text)
            item.time_s, item.place = float(clock.time_s(np.array(float(warning.frame)))), place_of(warning, sampled)
        check.state, check.checked = edit_state(scene), time.strftime("%Y-%m-%d %H:%M")
        _outdated[scene.session_uid] = False
        self.report({"INFO"}, message("Warnings: {count}", count=len(warnings)) if warnings else message("No warnings"))


class UNISIM_OT_go_to(bpy.types.Operator):
    """Go to the frame of a warning, select its object and show it"""

    bl_label = "Go to Warning"
    bl_options = {"REGISTER", "UNDO"}

    object_name: StringProperty(name="Object", options={"HIDDEN", "SKIP_SAVE"})
    frame: IntProperty(name="Frame", options={"HIDDEN", "SKIP_SAVE"})
    place: FloatVectorProperty(name="Location", size=3, options={"HIDDEN", "SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Frame, selection, and the view; where the object was deleted, the view goes where it was."""
        context.scene.frame_set(self.frame)
        obj = context.scene.objects.get(self.object_name)
        in_view = context.area is not None and context.area.type == "VIEW_3D" and not bpy.app.background
        if obj is None:
            if in_view and context.area.spaces.active.region_3d.view_perspective != "CAMERA":
                context.area.spaces.active.region_3d.view_location = self.place
            self.report({"WARNING"}, message('"{name}" no longer exists', name=self.object_name))
            return {"FINISHED"}
        choose(context, obj)
        if in_view and bpy.ops.view3d.view_selected.poll():
            bpy.ops.view3d.view_selected()
        return {"FINISHED"}


class UNISIM_PT_warnings(DrivePanel, bpy.types.Panel):
    """Implausible edits"""

    bl_label = "Check"
    bl_order = 7
    tasks = ("EDIT",)

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.operator("unisim.check", icon="CHECKMARK")
        check, outdated = context.scene.unisim_check, is_outdated(context.scene)
        if not check.state:
            self.layout.label(text="Not checked yet", icon="BLANK1")
            return
        if outdated:
            self.layout.label(text="Edited since the check", icon="FILE_REFRESH")
        elif not check.warnings:
            self.layout.label(text="No warnings", icon="BLANK1")
        else:
            text = interface("Warnings: {count}", count=len(check.warnings))
            self.layout.label(text=text, translate=False, icon="ERROR")
        column = self.layout.column(align=True)
        column.active = not outdated
        if check.shadows.text:
            draw_problem(column, localized(unpacked(check.shadows.text_parts, check.shadows.text)))
        for warning in check.warnings:
            text = f"{localized(instant_of(warning.time_s, warning.frame))}  {warning.name}"
            there = column.operator("unisim.go_to", text=text, translate=False, icon="ERROR")
            column.label(text=localized(cased(unpacked(warning.text_parts, warning.text), UPPER)), translate=False)
            there.object_name, there.frame, there.place = warning.name, warning.frame, warning.place


HANDLERS = (
    ("depsgraph_update_post", compare_soon),
    *((name, compare_all) for name in ("load_post", "undo_post", "redo_post")),
)
TIMERS = (compare,)


register = compare_all
