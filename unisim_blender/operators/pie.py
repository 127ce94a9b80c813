"""A pie menu of the edits that fit the kind of the active object: Ctrl-Alt-E in Object Mode, or another key
that a user sets."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import bpy

from ..registering import add, take_away

KEY: tuple[str, dict[str, bool]] = ("E", {"ctrl": True, "alt": True})
"""Blender's default keymap leaves it free in the 3D view's Object Mode, from 4.2 to 5.2."""


@dataclass(frozen=True)
class Slot:
    """An operator in a slot of the pie: its name, the text where that is not its own, an icon, and what
    it is called with."""

    operator: str
    text: str = ""
    icon: str = "NONE"
    given: dict[str, Any] = field(default_factory=dict)


CHECK = Slot("unisim.check", "Check Edits", "CHECKMARK")
RENDER = Slot("unisim.render_sequence", "Render Sequence", "RENDER_ANIMATION")
DELETE = Slot("unisim.delete_actor", "Delete", "TRASH")
SNAP = Slot("unisim.snap_to_ground", "Snap to Ground", "SNAP_FACE")
ADD_CAMERA = Slot("unisim.add_camera", "Add Camera", "CAMERA_DATA")
ADD_LIDAR = Slot("unisim.add_lidar", "Add LiDAR", "CONE")
MARK = Slot("unisim.mark_static", "Mark Static Item", "ADD")

SLOTS: dict[str, tuple[Slot | None, ...]] = {
    "ACTOR": (
        Slot("unisim.duplicate_actor", "Duplicate", "DUPLICATE"),
        DELETE,
        Slot("unisim.retime_actor", "Retime", "TIME"),
        Slot("unisim.shift_actor", "Shift", "ARROW_LEFTRIGHT"),
        Slot("unisim.replace_appearance", "Replace Appearance", "FILE_REFRESH"),
        SNAP,
        CHECK,
        RENDER,
    ),
    "EGO": (
        ADD_CAMERA,
        ADD_LIDAR,
        Slot("unisim.import_scene", "Import Trained Scene", "IMPORT"),
        Slot("unisim.shift_ego", "Shift Lane", "ARROW_LEFTRIGHT"),
        None,
        Slot("unisim.export_scenario", "Export Scenario", "EXPORT"),
        CHECK,
        RENDER,
    ),
    "CAMERA": (
        Slot("object.duplicate_move", "Duplicate", "DUPLICATE"),
        Slot("object.delete", "Delete", "TRASH"),
        ADD_CAMERA,
        Slot("unisim.aim_sensor", "Aim", "ORIENTATION_GIMBAL"),
        Slot("view3d.object_as_camera", "Look Through", "VIEW_CAMERA"),
        ADD_LIDAR,
        CHECK,
        RENDER,
    ),
    "LIDAR": (
        Slot("object.duplicate_move", "Duplicate", "DUPLICATE"),
        Slot("object.delete", "Delete", "TRASH"),
        ADD_LIDAR,
        Slot("unisim.aim_sensor", "Aim", "ORIENTATION_GIMBAL"),
        Slot("unisim.set_beams", "Change Beams", "LIGHT_SUN"),
        ADD_CAMERA,
        CHECK,
        RENDER,
    ),
    "STATIC": (
        Slot("unisim.copy_static", "Copy to 3D Cursor", "DUPLICATE"),
        DELETE,
        MARK,
        Slot("transform.translate", "Move", "ARROW_LEFTRIGHT"),
        Slot("unisim.forget_static", "Forget", "X"),
        SNAP,
        CHECK,
        RENDER,
    ),
    "NONE": (
        Slot("unisim.insert_actor", "Insert Actor", "ADD"),
        Slot("unisim.mesh_actor", "Use Mesh as Actor", "MESH_MONKEY"),
        MARK,
        Slot("unisim.shift_ego", "Shift Ego Lane", "ARROW_LEFTRIGHT"),
        ADD_CAMERA,
        ADD_LIDAR,
        CHECK,
        RENDER,
    ),
}
"""By kind of the active object, in Blender's order: left, right, below, above, upper left and right,
lower left and right."""


def kind_of_active(context: bpy.types.Context) -> str:
    """Return the kind of object that the pie is for: that of the active object where it is selected, else "NONE"."""
    obj = context.active_object
    kind = obj.unisim.kind if obj is not None and obj.select_get() else "NONE"
    return kind if kind in SLOTS else "NONE"


class UNISIM_MT_pie(bpy.types.Menu):
    """Edits of the active object of the drive"""

    bl_label = "UniSim"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return bool(context.scene.unisim.log)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a slot for each direction; what cannot be done is grey and says why."""
        pie = self.layout.menu_pie()
        pie.operator_context = "INVOKE_REGION_WIN"
        for slot in SLOTS[kind_of_active(context)]:
            if slot is None:
                pie.separator()
                continue
            button = pie.operator(slot.operator, text=slot.text, icon=slot.icon)
            for name, value in slot.given.items():
                setattr(button, name, value)


_keys: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []
CLASSES = (UNISIM_MT_pie,)


def register() -> None:
    """Add the menu and its shortcut."""
    add(CLASSES)
    configuration = bpy.context.window_manager.keyconfigs.addon
    if configuration is not None:  # there is none without a window
        keys = configuration.keymaps.new(name="Object Mode")
        item = keys.keymap_items.new("wm.call_menu_pie", KEY[0], "PRESS", **KEY[1])
        item.properties.name = UNISIM_MT_pie.__name__
        _keys.append((keys, item))


def unregister() -> None:
    """Take them away."""
    while _keys:
        keys, item = _keys.pop()
        keys.keymap_items.remove(item)
    take_away(CLASSES)
