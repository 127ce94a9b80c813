"""The edits list: go to an edit, take it back, mute it."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from bpy.props import IntProperty, StringProperty

from ...bridge.changes.muting import drop, mute, revert, unmute
from ...bridge.objects.imported import source_of
from ...bridge.sampling.edit_list import read_now, reading_of
from ...bridge.window import choose, drive, object_mode
from ...core.errors import UnisimError
from ...editing.edits.lines import EditLine, conflicting, nearest_frame
from ...editing.sampled.clock import Clock
from ...editing.texts import series
from ...translations import localized, message, tooltip
from ..operator_bases import Editing, reporting


class _OfEdit(Editing):
    """An operator on one line of the list."""

    needs = (object_mode, drive)

    kind: StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    name: StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    part: StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    muted: IntProperty(default=-1, options={"HIDDEN", "SKIP_SAVE"})

    def line(self: Any, context: bpy.types.Context) -> EditLine:
        """The line as the scene has it now. Raises `UnisimError`."""
        wanted = (self.kind, self.name, self.part), self.muted
        lines = [line for line in read_now(context.scene) if (line.key, line.muted) == wanted]
        if not lines:
            raise UnisimError(message("{name}: this edit is not there any more", name=self.name))
        return lines[0]

    @reporting
    def execute(self: Any, context: bpy.types.Context) -> set[str]:
        self.do(context, self.line(context))
        return {"FINISHED"}


class UNISIM_OT_go_to_edit(_OfEdit, bpy.types.Operator):
    """Select the object and go to a frame at which the edit shows"""

    bl_label = "Go to Edit"

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        key = properties.kind, properties.name, properties.part
        for line in reading_of(context.scene).lines:
            if (line.key, line.muted) == (key, properties.muted):
                said = [f"{line.who}: {localized(line.what)}"]
                if line.frames:
                    said.append(tooltip("Frames {first} to {last}", first=line.frames[0], last=line.frames[-1]))
                if line.muted >= 0:
                    said.append(tooltip("Muted: it does not count"))
                return ". ".join([*said, tooltip("Click to select it and to go to a frame at which it shows")])
        return tooltip(str(cls.__doc__))

    def do(self, context: bpy.types.Context, line: EditLine) -> None:
        scene = context.scene
        frame = nearest_frame(line.frames, scene.frame_current)
        if frame != scene.frame_current:
            scene.frame_set(frame)
        obj = scene.objects.get(line.object_name)
        if obj is not None and obj.name in context.view_layer.objects:
            choose(context, obj)
            return
        choose(context)
        said = message("{name} is muted" if line.muted >= 0 else "{name} is not in the scene", name=line.who)
        actor = source_of(scene).drive.actors.get(line.uid)
        if actor is not None:
            clock = Clock.of(source_of(scene).drive)
            x, y, _ = actor.world_from_actor.at(float(clock.time_s(np.array(float(frame)))))[:3, 3]
            said = message("{state}: it was recorded at x {x:.1f} m, y {y:.1f} m", state=said, x=float(x), y=float(y))
        self.report({"INFO"}, said)


class UNISIM_OT_revert_edit(_OfEdit, bpy.types.Operator):
    """Revert the edit: the object returns to its imported state, a copied or inserted object is deleted"""

    bl_label = "Revert Edit"

    def do(self, context: bpy.types.Context, line: EditLine) -> None:
        scene = context.scene
        if line.muted >= 0:
            drop(scene, line.muted)
        else:
            revert(scene, source_of(scene), line)
        reading_of(scene).mark()
        self.report({"INFO"}, message("Reverted: {what} ({who})", what=line.what, who=line.who))


class UNISIM_OT_mute_edit(_OfEdit, bpy.types.Operator):
    """Mute or unmute the edit; a muted edit is kept in the file and ignored in images, sweeps and scenarios"""

    bl_label = "Mute Edit"

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        if properties.muted >= 0:
            return tooltip("Let the edit count again; an edit of the same object that cannot stand beside it is muted")
        return tooltip("Mute the edit: it stays in the file and counts in no image, sweep or scenario")

    def do(self, context: bpy.types.Context, line: EditLine) -> None:
        scene = context.scene
        if line.muted < 0:
            mute(scene, source_of(scene), line)
            self.report({"INFO"}, message("Muted: {what} ({who})", what=line.what, who=line.who))
        else:
            conflicts = conflicting(line, reading_of(scene).lines)
            unmute(scene, source_of(scene), line.muted, conflicts)
            said = message("Unmuted: {what} ({who})", what=line.what, who=line.who)
            if conflicts:
                others = series([conflict.what for conflict in conflicts])
                said = message("{unmuted}; muted instead: {others}", unmuted=said, others=others)
            self.report({"INFO"}, said)
        reading_of(scene).mark()
