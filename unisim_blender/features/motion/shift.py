"""Actors shifted sideways, along their trajectory, and in time."""

import bpy
from bpy.props import FloatProperty

from ...bridge.changes.shifting import shift
from ...bridge.objects.source import source_of
from ...bridge.window.polling import allowed, object_mode, selected
from ...bridge.window.refresh import refresh
from ...bridge.window.selection import chosen
from ...core.errors import UnisimError
from ...editing.motion.durations import later_or_earlier
from ...editing.sampled.clock import Clock
from ...translations import localized, message


class UNISIM_OT_shift_actor(bpy.types.Operator):
    """Shift the selected actors sideways, along the path of their trajectory and in time, alike at every time"""

    bl_idname = "unisim.shift_actor"
    bl_label = "Shift Actor"
    bl_options = {"REGISTER", "UNDO"}

    left_m: FloatProperty(
        name="Sideways",
        description="Shift to the left of the actor; negative values shift to the right",
        default=1.0,
        soft_min=-10.0,
        soft_max=10.0,
        unit="LENGTH",
    )
    ahead_m: FloatProperty(
        name="Along Path",
        description="Forward by this length of the trajectory's path, round its turns, and straight on beyond its ends; "
        "actors that do not move are shifted along their own axis; negative values shift backward",
        default=0.0,
        soft_min=-50.0,
        soft_max=50.0,
        unit="LENGTH",
    )
    later_s: FloatProperty(
        name="Later",
        description="Shift in time in seconds of the log, including when the actor is present; negative values shift earlier",
        default=0.0,
        soft_min=-10.0,
        soft_max=10.0,
        unit="TIME_ABSOLUTE",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """An actor has to be selected."""
        return allowed(cls, object_mode(context), selected(context, "Select an actor first", "ACTOR"))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the three amounts, and how many frames the seconds are."""
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        for name in ("left_m", "ahead_m", "later_s"):
            layout.prop(self, name)
        try:
            clock = Clock.of(source_of(context.scene).drive)
        except (UnisimError, OSError):
            return
        layout.label(text=localized(later_or_earlier(self.later_s, clock)), translate=False)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Shift each and report what was done."""
        try:
            clock = Clock.of(source_of(context.scene).drive)
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        actors = chosen(context, "ACTOR")
        said = [sentence for obj in actors if (sentence := shift(obj, self.left_m, self.ahead_m, self.later_s, clock))]
        refresh(actors)
        told = localized(said[0]) if said else message("Nothing is shifted: all amounts are 0")
        if len(said) > 1:
            told = message("{sentence} (and {count} more)", sentence=told, count=len(said) - 1)
        self.report({"INFO"}, told)
        return {"FINISHED"}


CLASSES = (UNISIM_OT_shift_actor,)
