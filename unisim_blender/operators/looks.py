"""Actors with another look, and actors of other trained scenes."""

from pathlib import Path

import bpy
import numpy as np
from bpy.props import EnumProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..bridge.meshes import size_of
from ..bridge.motion import displaced_along
from ..bridge.refresh import refresh
from ..bridge.selection import choose, chosen
from ..bridge.source import source_of
from ..bridge.things import box_mesh, collection_of, new_actor
from ..core.drive import Actor
from ..core.errors import UnisimError
from ..core.prepare.scenario import scene_actors
from ..core.scene_file import HEADER_NAME
from ..translations import message
from .polling import allowed, drive, object_mode, selected

_shown: list[tuple[str, str, str]] = []
"""What a menu shows has to be kept: Blender does not."""


def actor_items(self: bpy.types.Operator, context: bpy.types.Context) -> list[tuple[str, str, str]]:
    """The actors that a trained scene or the log holds, for a menu."""
    try:
        actors = looks_of(context, self.scene)
    except (UnisimError, OSError):
        actors = {}
    _shown[:] = [(uid, f"{actor.label} {uid[:8]}", size_text(actor)) for uid, actor in sorted(actors.items())]
    return _shown or [("", "None", "")]


def size_text(actor: Actor) -> str:
    """An actor's size for a tooltip."""
    return " x ".join(f"{edge:.1f}" for edge in actor.size_m) + " m"


def looks_of(context: bpy.types.Context, scene: str) -> dict[str, Actor]:
    """The actors of the trained scene in a folder, or of the imported drive."""
    return scene_actors(Path(bpy.path.abspath(scene))) if scene else source_of(context.scene).drive.actors


class UNISIM_OT_replace_look(bpy.types.Operator):
    """Replace the appearance and the box of the selected actors by those of another actor, on the same trajectory"""

    bl_idname = "unisim.replace_look"
    bl_label = "Replace Appearance"
    bl_options = {"REGISTER", "UNDO"}
    bl_property = "look"

    scene: StringProperty(
        name="Trained scene", description="Folder of the trained scene; empty for the one of the drive", subtype="DIR_PATH"
    )
    look: EnumProperty(name="Appearance", description="Actor whose appearance is used", items=actor_items)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """An actor has to be selected; what is a mesh keeps its own look."""
        plain = not any(thing.unisim.mesh for thing in chosen(context, "ACTOR"))
        return allowed(
            cls,
            object_mode(context),
            selected(context, "Select an actor first", "ACTOR"),
            (plain, "Mesh actors keep their own appearance: select recorded actors only"),
        )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask which."""
        context.window_manager.invoke_search_popup(self)
        return {"FINISHED"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Other boxes, their undersides where they were."""
        try:
            look = looks_of(context, self.scene)[self.look]
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        for thing in chosen(context, "ACTOR"):
            before = float(size_of(thing)[2])
            own = thing.unisim.uid == self.look and not self.scene
            thing.unisim.look, thing.unisim.look_scene = ("", "") if own else (self.look, self.scene)
            thing.data = box_mesh(look.size_m, look.label)
            displaced_along(thing, (0.0, 0.0, (float(look.size_m[2]) - before) / 2))
        refresh(chosen(context, "ACTOR"))
        return {"FINISHED"}


class UNISIM_OT_insert_actor(bpy.types.Operator, ImportHelper):
    """Insert an actor of a trained scene at the 3D cursor"""

    bl_idname = "unisim.insert_actor"
    bl_label = "Insert Actor"
    bl_options = {"REGISTER", "UNDO"}

    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})
    actor: StringProperty(name="Actor", description="Identifier in the trained scene; empty for the first vehicle")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return allowed(cls, object_mode(context), drive(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """A box that stands on the ground at the cursor."""
        chosen_path = Path(self.filepath)
        folder = chosen_path.parent if chosen_path.name == HEADER_NAME else chosen_path
        try:
            actors = scene_actors(folder)
            uid = self.actor or next(
                (u for u, a in sorted(actors.items()) if "car" in a.label.lower()), next(iter(sorted(actors)))
            )
            if uid not in actors:
                raise UnisimError(message('{folder}: has no actor "{name}"', folder=folder, name=uid))
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        actor = actors[uid]
        thing = new_actor(f"{actor.label} {uid[:6]}", actor)
        collection_of(context.scene, "ACTOR").objects.link(thing)
        thing.unisim.look, thing.unisim.look_scene = uid, str(folder)
        thing.location = np.array(context.scene.cursor.location) + [0.0, 0.0, actor.size_m[2] / 2]
        thing.rotation_quaternion = context.scene.cursor.matrix.to_quaternion()
        choose(context, thing)
        return {"FINISHED"}


CLASSES = (UNISIM_OT_replace_look, UNISIM_OT_insert_actor)
