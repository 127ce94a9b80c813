"""Actors on the same path at other times."""

from collections.abc import Callable

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty, IntProperty

from ..bridge.motion import retimed, stopped
from ..bridge.sampling import frame_of
from ..bridge.selection import chosen
from ..core.geometry import FloatArray

WAYS = (
    ("DELAY", "Delay", "Everything later by some frames"),
    ("SPEED", "Speed", "Faster or slower from the frame that is shown on"),
    ("STOP", "Stop and go", "Stand still from the frame that is shown on, then go on"),
    ("STRETCH", "Stretch", "Take longer or shorter between two frames; what comes later is later or earlier by that"),
)


class UNISIM_OT_retime_actor(bpy.types.Operator):
    """Let the selected actors go the same path at other times"""

    bl_idname = "unisim.retime_actor"
    bl_label = "Retime Actor"
    bl_options = {"REGISTER", "UNDO"}

    way: EnumProperty(name="Way", items=WAYS, default="DELAY")
    frames: FloatProperty(name="Frames", description="How many frames later, or how long it stands still", default=5.0)
    speed: FloatProperty(name="Speed", description="1 is as it was", default=0.5, min=0.01, soft_max=4.0)
    first: IntProperty(name="From", default=0)
    last: IntProperty(name="To", default=20)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """An actor has to be selected."""
        return context.mode == "OBJECT" and bool(chosen(context, "ACTOR"))

    def draw(self, context: bpy.types.Context) -> None:
        """What the chosen way needs."""
        self.layout.prop(self, "way")
        needed = {"DELAY": ("frames",), "SPEED": ("speed",), "STOP": ("frames",), "STRETCH": ("first", "last", "speed")}
        for name in needed[self.way]:
            self.layout.prop(self, name)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Move keys."""
        if self.way == "STRETCH" and self.first >= self.last:
            self.report({"ERROR"}, f"From {self.first} must lie before to {self.last}")
            return {"CANCELLED"}
        now = frame_of(context.scene)
        for thing in chosen(context, "ACTOR"):
            if self.way == "STOP":
                stopped(thing, now, abs(self.frames))
            else:
                retimed(thing, self.later(now))
        return {"FINISHED"}

    def later(self, now: float) -> Callable[[FloatArray], FloatArray]:
        """Where keys at frames go."""
        if self.way == "DELAY":
            return lambda old: old + self.frames
        if self.way == "SPEED":
            return lambda old: np.where(old > now, now + (old - now) / self.speed, old)
        first, last = self.first, self.last
        longer = (last - first) * (1 / self.speed - 1)
        return lambda old: old + longer * np.clip((old - first) / (last - first), 0, 1)


CLASSES = (UNISIM_OT_retime_actor,)
