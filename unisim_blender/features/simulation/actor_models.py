"""Models of actors in simulations: given to the selected ones, and taken back."""

from __future__ import annotations

import bpy
from bpy.props import StringProperty

from ...bridge.objects.simulation import modelled
from ...bridge.window.polling import Need, allowed, drive, selected
from ...bridge.window.selection import chosen
from ...translations import message


class UNISIM_OT_same_model(bpy.types.Operator):
    """Give the selected actors the model of the active one, with its parameters"""

    bl_idname = "unisim.same_model"
    bl_label = "Same for Selected"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """An actor has to be active, and others be selected."""
        return allowed(
            cls,
            drive(context),
            active_actor(context),
            selected(context, "Select an actor first", "ACTOR"),
            (len(chosen(context, "ACTOR")) > 1, "Select further actors: the active one has this model already"),
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Copy the document."""
        document, found = context.active_object.unisim_model.document, chosen(context, "ACTOR")
        for obj in found:
            obj.unisim_model.document = document
        self.report({"INFO"}, message("Actors with this model: {count}", count=len(found)))
        return {"FINISHED"}


class UNISIM_OT_forget_model(bpy.types.Operator):
    """Let the actor move as all others do in simulations"""

    bl_idname = "unisim.forget_model"
    bl_label = "As All Others"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(name="Actor", description="The object's name", options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """An actor has to have a model."""
        return allowed(cls, drive(context), (modelled(context.scene), "No actor has a model of its own"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Take the model away."""
        obj = context.scene.objects.get(self.name)
        if obj is None:
            self.report({"WARNING"}, message('"{name}" is not there any more', name=self.name))
            return {"CANCELLED"}
        obj.unisim_model.document = ""
        return {"FINISHED"}


def active_actor(context: bpy.types.Context) -> Need:
    """An actor of the scene is active."""
    obj = context.active_object
    there = obj is not None and obj.unisim.kind == "ACTOR" and obj.name in context.scene.objects
    return there, "Make an actor active first: click it"


CLASSES = (UNISIM_OT_same_model, UNISIM_OT_forget_model)
