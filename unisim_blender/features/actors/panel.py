"""Panel Actor: the active actor's card, and what can be done with the selected ones."""

import json
from pathlib import Path

import bpy

from ...bridge.objects.imported import drive_of
from ...bridge.views.actors import card_of
from ...core.errors import UnisimError
from ...editing.actors.table import ActorCard
from ...editing.sampled.scene import size_text
from ...editing.texts import kmh
from ...translations import interface, localized
from ..sidebar import DrivePanel, row_of
from . import thumbnails
from .appearances import header_of

PORTRAIT_SCALE = 4.0
"""Edge of the thumbnail, in widget units."""


def active_card(context: bpy.types.Context) -> ActorCard | None:
    """Return the card of the active actor; None where another object is active."""
    obj = context.active_object
    if obj is None or obj.unisim.kind != "ACTOR" or obj.name not in context.scene.objects:
        return None
    drive = drive_of(context.scene)
    return None if drive is None else card_of(context.scene, obj, drive)


def portrait(context: bpy.types.Context) -> int:
    """Return the thumbnail of the active actor; that of a mesh is grey."""
    about = context.active_object.unisim
    if about.mesh:
        return thumbnails.grey()
    if about.look_scene:
        folder = Path(bpy.path.abspath(about.look_scene))
        return thumbnails.icon_of(log_beside(folder), about.look, folder)
    return thumbnails.icon_of(
        thumbnails.log_of(context.scene), about.look or about.uid, thumbnails.scene_of(context.scene)
    )


def log_beside(folder: Path) -> Path:
    """Return the log that the trained scene in a folder was trained on; the folder itself where it cannot be read."""
    try:
        return (folder / header_of(folder).log_path).resolve()
    except (UnisimError, OSError):
        return folder


def card_lines(card: ActorCard) -> tuple[str, ...]:
    """Return what the card says beside the thumbnail."""
    present = "–"
    if card.present_s is not None:
        present = interface("Present {start:.1f} to {end:.1f} s", start=card.present_s[0], end=card.present_s[1])
    distance = interface("{speed}, {distance:.1f} m away", speed=kmh(card.speed_m_s), distance=card.distance_m)
    label = card.label if card.role == "recorded" else f"{card.label}, {localized(card.role)}"
    return card.name, label, card.size, distance, present


class UNISIM_PT_actor(DrivePanel, bpy.types.Panel):
    """The active actor, and what can be done with the selected ones"""

    bl_label = "Actor"
    bl_order = 0
    tasks = ("EDIT",)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the card and the operators; rows stay in place whatever is selected."""
        layout, card = self.layout, active_card(context)
        row = layout.box().split(factor=0.34)
        row.template_icon(portrait(context) if card else thumbnails.grey(), scale=PORTRAIT_SCALE)
        lines = row.column(align=True)
        for text in card_lines(card) if card else (interface("No active actor"), *"––––"):
            lines.label(text=text, translate=False)
        column = layout.column(align=True)
        row = column.row(align=True)
        row.operator_menu_enum("unisim.duplicate_actor", "where", text="Duplicate", icon="DUPLICATE")
        row.operator("unisim.delete_actor", text="Delete", icon="TRASH")
        column.operator_menu_enum("unisim.retime_actor", "mode", text="Retime", icon="TIME")
        column.operator_menu_enum("unisim.maneuver", "kind", icon="CON_FOLLOWPATH")
        column.operator("unisim.shift_actor", icon="ARROW_LEFTRIGHT")
        column.operator("unisim.follow_curve", icon="CURVE_PATH")
        column.operator("unisim.snap_to_ground", icon="SNAP_FACE")
        column.operator_menu_enum("unisim.swap_class", "group", icon="MOD_INSTANCE")
        column.operator("unisim.replace_appearance", icon="FILE_REFRESH")


class UNISIM_PT_insert(DrivePanel, bpy.types.Panel):
    """Actors that nobody recorded there"""

    bl_label = "Insert"
    bl_parent_id = "UNISIM_PT_actor"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        column.operator("unisim.insert_actor", icon="ADD")
        column.operator("unisim.insert_from", icon="FILE_FOLDER")
        column.operator("unisim.row_of_cones", icon="CONE")
        column.operator("unisim.parked_row", icon="AUTO")
        column.operator("unisim.mesh_actor", icon="MESH_MONKEY")
        column.operator("unisim.release_mesh", icon="X")


class UNISIM_PT_static(DrivePanel, bpy.types.Panel):
    """Things without annotation, as boxes of space"""

    bl_label = "Static Items"
    bl_parent_id = "UNISIM_PT_actor"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        obj = context.active_object
        item = obj if obj is not None and obj.unisim.kind == "STATIC" else None
        size = size_text(json.loads(item.unisim.model)["size_m"], digits=2) if item is not None else ""
        column = self.layout.column(align=True)
        row_of(column, "Item", item.name if item is not None else "", "MESH_CUBE")
        row_of(column, "Box", size)
        column.operator("unisim.mark_static", icon="ADD")
        column.operator("unisim.copy_static", icon="DUPLICATE")
        column.operator("unisim.forget_static", icon="X")
