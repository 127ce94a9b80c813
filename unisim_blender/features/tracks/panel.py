"""Panel Boxes: actors of a log found, followed from a drawn box, corrected and saved."""

import json

import bpy

from ...bridge.importing.tracks import drawn_of, tracks_in
from ...translations import interface
from ..sidebar import DrivePanel, draw_task, row_of, settings_column
from .following import following
from .operators import FindTask


class UNISIM_PT_boxes(DrivePanel, bpy.types.Panel):
    """Boxes of actors: found, drawn, followed, corrected, saved"""

    bl_label = "Boxes"
    bl_order = 5
    tasks = ("VIEW",)

    def draw(self, context: bpy.types.Context) -> None:
        """Rows stay in place whatever is selected."""
        layout, scene = self.layout, context.scene
        about, boxes = scene.unisim_tracks, tracks_in(scene)
        column = layout.column(align=True)
        row = column.row(align=True)
        row.operator("unisim.find_actors", icon="VIEWZOOM")
        row.operator("unisim.edit_boxes", text="Edit", icon="GREASEPENCIL")
        column.operator_menu_enum("unisim.draw_box", "label", icon="MESH_CUBE")
        draw_task(layout, scene, FindTask)
        column = settings_column(layout)
        column.prop(about, "certainty", slider=True)
        shown = sum(obj.unisim_track.certainty >= about.certainty for obj in boxes)
        row_of(column, "Boxes", interface("{shown} of {count}", shown=shown, count=len(boxes)) if boxes else "")
        obj = context.active_object
        track = obj.unisim_track if obj is not None and obj.unisim.kind == "TRACK" else None
        row_of(column, "Box", f"{obj.name}, {track.certainty:.0%}" if track is not None else "")
        row_of(column, "Keys", str(len(drawn_of(obj))) if track is not None else "")
        column = layout.column(align=True)
        row = column.row(align=True)
        row.operator("unisim.track_this", icon="TRACKING")
        row.operator("unisim.stop_tracking", text="", icon="CANCEL")
        column.operator("unisim.keep_box", icon="KEY_HLT")
        settings_column(layout).prop(about, "refine")
        busy = context.window_manager.unisim_following
        layout.label(text=busy or ("…" if following else "–"), translate=False)
        column = layout.column(align=True)
        row = column.row(align=True)
        row.operator("unisim.accept_boxes", icon="CHECKMARK")
        row.operator("unisim.delete_boxes", text="Delete", icon="TRASH")
        row = column.row(align=True)
        row.operator_menu_enum("unisim.merge_boxes", "other", icon="AUTOMERGE_ON")
        row.operator("unisim.split_boxes", icon="MOD_EDGESPLIT")
        column.operator_menu_enum("unisim.class_boxes", "label", icon="OUTLINER_OB_GROUP_INSTANCE")
        column = layout.column(align=True)
        row = column.row(align=True)
        row.operator("unisim.next_doubtful", icon="ERROR")
        row.operator("unisim.next_doubtful", text="", icon="BACK").back = True
        row.operator("unisim.dismiss_doubtful", text="", icon="CHECKMARK")
        place = json.loads(about.place or "null")
        column.label(text=f"{place['number']}/{place['count']}: {place['text']}" if place else "–", translate=False)
        settings_column(layout).prop(about, "show_sides")
        row = layout.row(align=True)
        row.operator("unisim.save_boxes", icon="FILE_TICK")
        row.operator("unisim.discard_boxes", text="", icon="X")
