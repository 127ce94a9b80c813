"""Access to operators beside the sidebar: the Object, Add and Render menus, shortcuts, and a pie menu of the edits
that fit the kind of the active object; and the active camera's image size."""

from __future__ import annotations

from typing import Any, NamedTuple

import bpy
from bpy.app.handlers import persistent

from ..bridge.importing.drive import fit_resolution
from ..editing.texts import translatable
from ..preferences import SECTIONS
from ..registering import Shortcut, keys_of

BOTH = ("ctrl", "alt")
SHORTCUTS = (
    Shortcut("unisim.duplicate_actor", "D", BOTH),
    Shortcut("unisim.retime_actor", "T", BOTH),
    Shortcut("unisim.snap_to_ground", "G", BOTH),
    Shortcut("unisim.check", "K", BOTH),
    # Blender's default keymap leaves it free in the 3D view's Object Mode, from 4.2 to 5.2
    Shortcut("wm.call_menu_pie", "E", BOTH, {"name": "UNISIM_MT_pie"}),
)
_active: dict[int, int | None] = {}
"""The camera that was active in each scene at the last look."""


class UNISIM_MT_object(bpy.types.Menu):
    """Edit a drive"""

    bl_label = "UniSim"
    bl_description = "Edits of the selected parts of the drive"

    def draw(self, context: bpy.types.Context) -> None:
        draw_groups(self.layout, OBJECT_MENU)


class UNISIM_MT_render(bpy.types.Menu):
    """Sequences, simulations, batches, variants and training"""

    bl_label = "UniSim"
    bl_description = "Sequences, simulations, batches, variants and training"

    def draw(self, context: bpy.types.Context) -> None:
        draw_groups(self.layout, RENDER_MENU)


OBJECT_MENU = (
    "duplicate_actor.where delete_actor replace_appearance swap_class.group maneuver.kind retime_actor.mode shift_actor "
    "follow_curve snap_to_ground mesh_actor release_mesh ego_body release_ego_body parked_row row_of_cones",
    "mark_static copy_static forget_static find_lamps add_street_lamp",
    "shift_ego aim_sensor set_beams.preset UNISIM_MT_rig_presets save_rig restore_sensors",
    "find_actors edit_boxes draw_box.label track_this keep_box stop_tracking next_doubtful dismiss_doubtful",
    "accept_boxes delete_boxes class_boxes.label merge_boxes.other split_boxes save_boxes discard_boxes",
    "select_listed check",
)
RENDER_MENU = (
    "render_variants export_variants open_output play_result make_film open_film export_scenario",
    "simulate drive_on open_rollout compare_rollouts",
    "submit_batch open_report",
    "new_variant rename_variant delete_variant",
    "train make_library",
)
"""Operators of the menus, in groups, with the choice that a menu of its own offers; and a menu."""


def draw_groups(layout: bpy.types.UILayout, groups: tuple[str, ...]) -> None:
    """Draw a menu's groups."""
    for number, group in enumerate(groups):
        if number:
            layout.separator()
        for name in group.split():
            operator, _, choice = name.partition(".")
            if name.startswith("UNISIM_MT_"):
                layout.menu(name)
            elif choice:
                layout.operator_menu_enum("unisim." + operator, choice)
            else:
                layout.operator("unisim." + operator)


class UNISIM_MT_view(bpy.types.Menu):
    """What of the drive the views show"""

    bl_label = "UniSim"
    bl_description = "What of the drive the views show"

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        for name in ("show_ways", "show_sensors", "show_timeline"):
            layout.prop(scene.unisim, name)
        layout.prop(scene.unisim_motion, "show_graph")
        layout.operator("unisim.recorded_colours")
        layout.operator("unisim.import_sensors")
        layout.operator("unisim.birds_eye")
        for text, recorded, simulated in POINTS:
            shown = layout.operator("unisim.show_points", text=text)
            shown.recorded, shown.simulated = recorded, simulated


POINTS = (
    (translatable("Hide LiDAR Points"), False, False),
    (translatable("Recorded LiDAR Points"), True, False),
    (translatable("Simulated LiDAR Points"), False, True),
)


def draw_view_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """A line in the 3D view's View menu."""
    if context.scene.unisim.log:
        self.layout.menu("UNISIM_MT_view")


def draw_object_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """A line in the 3D view's Object menu."""
    if context.scene.unisim.log:
        self.layout.menu("UNISIM_MT_object")


def draw_context_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw lines at the top of the 3D view's context menu."""
    if context.scene.unisim.log:
        self.layout.operator_menu_enum("unisim.maneuver", "kind")
        self.layout.menu("UNISIM_MT_object")
        self.layout.separator()


def draw_add_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Lines in the Add menu."""
    if context.scene.unisim.log:
        self.layout.separator()
        self.layout.operator("unisim.insert_actor", text="Actor of the Drive")
        self.layout.operator("unisim.insert_from", text="Actor of a Trained Scene")
        self.layout.operator("unisim.row_of_cones")
        self.layout.operator("unisim.add_camera", text="Camera on the Vehicle")
        self.layout.operator_menu_enum("unisim.add_lidar", "preset", text="LiDAR on the Vehicle")


def draw_render_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw lines in the Render menu, where people look for a sequence, and where the menu search finds it."""
    if context.scene.unisim.log:
        self.layout.separator()
        self.layout.operator("unisim.render_sequence", text="Render Sequence of Sensors", icon="RENDER_ANIMATION")
        self.layout.operator("unisim.cancel_task", text="Cancel Background Task")
        self.layout.operator("unisim.locate_log")
        self.layout.operator("unisim.show_preferences")
        self.layout.menu("UNISIM_MT_render")


def draw_shortcuts(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the shortcuts as the user has them, to be changed here."""
    import rna_keymap_ui  # which Blender's module for Python may lack

    layout.label(text="Shortcuts")
    configuration = context.window_manager.keyconfigs.user
    for keys, own in keys_of(__name__):
        keymap = configuration.keymaps.get(keys.name)
        for item in keymap.keymap_items if keymap is not None else ():
            names = [getattr(key.properties, "name", "") for key in (item, own)]
            if item.idname == own.idname and names[0] == names[1]:
                layout.context_pointer_set("keymap", keymap)
                rna_keymap_ui.draw_kmi([], configuration, keymap, item, layout, 0)


@persistent
def follow_camera(scene: bpy.types.Scene, *_: object) -> None:
    """Another camera is active: images become as large as its own, if it is one of the rig.

    Told after any change of the scene: the message bus does not hear of Ctrl-Numpad 0.
    """
    camera = scene.camera.session_uid if scene.camera is not None else None
    if _active.setdefault(scene.session_uid, camera) != camera and not bpy.app.is_job_running("RENDER"):
        _active[scene.session_uid] = camera
        fit_resolution(scene)


@persistent
def note_cameras(*_: object) -> None:
    """Remember which cameras are active in the scenes of a file."""
    for scene in getattr(bpy.data, "scenes", ()):  # there are none yet while the extension is switched on
        follow_camera(scene)


class Slot(NamedTuple):
    """An operator in a slot of the pie: its name, text and icon, and what it is called with."""

    operator: str
    text: str
    icon: str
    given: dict[str, Any] = {}


DELETE = Slot("unisim.delete_actor", "Delete", "TRASH")
ADD_CAMERA = Slot("unisim.add_camera", "Add Camera", "CAMERA_DATA")
ADD_LIDAR = Slot("unisim.add_lidar", "Add LiDAR", "CONE")
MANEUVER = Slot("wm.call_menu_pie", "Maneuver", "CON_FOLLOWPATH", {"name": "UNISIM_MT_maneuver_pie"})
MARK = Slot("unisim.mark_static", "Mark Static Item", "ADD")
AIM = Slot("unisim.aim_sensor", "Aim", "ORIENTATION_GIMBAL")
OF_SENSOR = (
    Slot("object.duplicate_move", "Duplicate", "DUPLICATE"),
    Slot("object.delete", "Delete", "TRASH"),
)
OF_ALL = (
    Slot("unisim.check", "Check Edits", "CHECKMARK"),
    Slot("unisim.render_sequence", "Render Sequence", "RENDER_ANIMATION"),
)
SLOTS: dict[str, tuple[Slot, ...]] = {
    "ACTOR": (
        Slot("unisim.duplicate_actor", "Duplicate", "DUPLICATE"),
        DELETE,
        Slot("unisim.retime_actor", "Retime", "TIME"),
        Slot("unisim.shift_actor", "Shift", "ARROW_LEFTRIGHT"),
        Slot("unisim.replace_appearance", "Replace Appearance", "FILE_REFRESH"),
        MANEUVER,
        *OF_ALL,
    ),
    "EGO": (
        ADD_CAMERA,
        ADD_LIDAR,
        Slot("unisim.import_scene", "Import Trained Scene", "IMPORT"),
        Slot("unisim.shift_ego", "Shift Lane", "ARROW_LEFTRIGHT"),
        MANEUVER,
        Slot("unisim.export_scenario", "Export Scenario", "EXPORT"),
        *OF_ALL,
    ),
    "CAMERA": (
        *OF_SENSOR,
        ADD_CAMERA,
        AIM,
        Slot("view3d.object_as_camera", "Look Through", "VIEW_CAMERA"),
        ADD_LIDAR,
        *OF_ALL,
    ),
    "LIDAR": (
        *OF_SENSOR,
        ADD_LIDAR,
        AIM,
        Slot("unisim.set_beams", "Change Beams", "LIGHT_SUN"),
        ADD_CAMERA,
        *OF_ALL,
    ),
    "STATIC": (
        Slot("unisim.copy_static", "Copy to 3D Cursor", "DUPLICATE"),
        DELETE,
        MARK,
        Slot("transform.translate", "Move", "ARROW_LEFTRIGHT"),
        Slot("unisim.forget_static", "Forget", "X"),
        Slot("unisim.snap_to_ground", "Snap to Ground", "SNAP_FACE"),
        *OF_ALL,
    ),
    "NONE": (
        Slot("unisim.insert_actor", "Insert Actor", "ADD"),
        Slot("unisim.mesh_actor", "Use Mesh as Actor", "MESH_MONKEY"),
        MARK,
        Slot("unisim.shift_ego", "Shift Ego Lane", "ARROW_LEFTRIGHT"),
        ADD_CAMERA,
        MANEUVER,
        *OF_ALL,
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
    bl_description = "Edits of the active object of the drive"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.unisim.log)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a slot for each direction; what cannot be done is grey and says why."""
        pie = self.layout.menu_pie()
        pie.operator_context = "INVOKE_REGION_WIN"
        for slot in SLOTS[kind_of_active(context)]:
            button = pie.operator(slot.operator, text=slot.text, icon=slot.icon)
            for name, value in slot.given.items():
                setattr(button, name, value)


class UNISIM_MT_maneuver_pie(bpy.types.Menu):
    """Maneuvers of the active actor, or of a new one"""

    bl_label = "Maneuver"
    bl_description = "Maneuvers of the active actor, or of a new one"

    def draw(self, context: bpy.types.Context) -> None:
        pie = self.layout.menu_pie()
        pie.operator_enum("unisim.maneuver", "kind")
        pie.operator("unisim.row_of_cones", icon="CONE")
        pie.operator("unisim.parked_row", icon="AUTO")
        pie.operator_menu_enum("unisim.swap_class", "group", icon="MOD_INSTANCE")


MENUS = (
    (bpy.types.VIEW3D_MT_view, draw_view_menu),
    (bpy.types.VIEW3D_MT_object, draw_object_menu),
    (bpy.types.VIEW3D_MT_add, draw_add_menu),
    (bpy.types.TOPBAR_MT_render, draw_render_menu),
)
HANDLERS = (("load_post", note_cameras), ("depsgraph_update_post", follow_camera))


def register() -> None:
    """Add the context menu's lines at its top, and the shortcuts to the preferences."""
    bpy.types.VIEW3D_MT_object_context_menu.prepend(draw_context_menu)
    SECTIONS.append(draw_shortcuts)
    note_cameras()


def unregister() -> None:
    """Take them away."""
    _active.clear()
    bpy.types.VIEW3D_MT_object_context_menu.remove(draw_context_menu)
