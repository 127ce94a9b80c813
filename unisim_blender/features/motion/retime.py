"""Actors on the same path at other times."""

from collections.abc import Callable

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty

from ...bridge.changes.motion import retimed, stopped
from ...bridge.objects.source import source_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.window.polling import allowed, object_mode, selected
from ...bridge.window.refresh import refresh
from ...bridge.window.selection import chosen, counted_names
from ...core.errors import UnisimError
from ...core.geometry import FloatArray
from ...editing.motion.durations import duration, instant, later_or_earlier, span, stretched
from ...editing.sampled.clock import Clock
from ...editing.texts import Text, series
from ...translations import localized, message

MODES = (
    ("DELAY", "Delay", "Delay the whole trajectory"),
    ("SPEED", "Speed", "Change the speed from the current frame on"),
    ("STOP", "Stop and go", "Stop at the current frame, then continue"),
    ("STRETCH", "Stretch", "Change the speed between two times; later keyframes shift accordingly"),
)
NEEDED = {"DELAY": ("seconds",), "SPEED": ("speed",), "STOP": ("seconds",), "STRETCH": ("first_s", "last_s", "speed")}


class UNISIM_OT_retime_actor(bpy.types.Operator):
    """Change when the selected actors are where on their trajectories"""

    bl_idname = "unisim.retime_actor"
    bl_label = "Retime Actor"
    bl_options = {"REGISTER", "UNDO"}

    mode: EnumProperty(name="Mode", description="Kind of time change", items=MODES, default="DELAY")
    seconds: FloatProperty(
        name="Seconds",
        description="Delay or duration of the stop, in seconds of the log",
        default=0.5,
        unit="TIME_ABSOLUTE",
    )
    speed: FloatProperty(name="Speed", description="Factor of the original speed", default=0.5, min=0.01, soft_max=4.0)
    first_s: FloatProperty(
        name="From", description="Start time, in seconds of the log", default=0.0, unit="TIME_ABSOLUTE"
    )
    last_s: FloatProperty(name="To", description="End time, in seconds of the log", default=2.0, unit="TIME_ABSOLUTE")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """An actor has to be selected."""
        return allowed(cls, object_mode(context), selected(context, "Select an actor first", "ACTOR"))

    def draw(self, context: bpy.types.Context) -> None:
        """Show what the chosen mode needs, in seconds and in frames."""
        self.layout.prop(self, "mode")
        for name in NEEDED[self.mode]:
            self.layout.prop(self, name)
        try:
            clock = Clock.of(source_of(context.scene).drive)
        except (UnisimError, OSError):
            return
        for line in self.lines(float(clock.time_s(np.array(frame_of(context.scene)))), clock):
            self.layout.label(text=localized(line), translate=False)

    def lines(self, now_s: float, clock: Clock) -> list[str]:
        """Return what the chosen mode comes to, in seconds and in frames."""
        if self.mode == "STRETCH":
            return stretched(self.first_s, self.last_s, self.speed, clock)
        if self.mode == "SPEED":
            return [
                Text("From {time} on", time=instant(now_s, clock)),
                Text("What takes 1 s takes {duration}", duration=duration(1 / self.speed, clock)),
            ]
        if self.mode == "STOP":
            stands = abs(self.seconds)
            return [Text("Stands for {duration}", duration=duration(stands, clock)), span(now_s, now_s + stands, clock)]
        return [later_or_earlier(self.seconds, clock)]

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Move keys."""
        if self.mode == "STRETCH" and self.first_s >= self.last_s:
            self.report(
                {"ERROR"},
                message(
                    "From ({first:g} s) must be earlier than To ({last:g} s)", first=self.first_s, last=self.last_s
                ),
            )
            return {"CANCELLED"}
        try:
            clock = Clock.of(source_of(context.scene).drive)
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        now, actors = frame_of(context.scene), chosen(context, "ACTOR")
        for obj in actors:
            if self.mode == "STOP":
                stopped(obj, now, abs(self.seconds), clock)
            else:
                retimed(obj, self.later(now, clock))
        refresh(actors)
        done = self.briefly(float(clock.time_s(np.array(now))), clock)
        self.report({"INFO"}, localized(series([counted_names(actors), done], ": ")))
        return {"FINISHED"}

    def briefly(self, now_s: float, clock: Clock) -> str:
        """Return what the chosen mode comes to, in one line that the status bar has room for."""
        if self.mode == "STRETCH":
            whole = duration(self.last_s - self.first_s, clock)
            return Text("speed x{speed:.3g} for {duration}", speed=self.speed, duration=whole)
        if self.mode == "SPEED":
            return Text("speed x{speed:.3g} from {time} on", speed=self.speed, time=instant(now_s, clock))
        if self.mode == "STOP":
            return Text("stands for {duration}", duration=duration(abs(self.seconds), clock))
        return self.lines(now_s, clock)[0]

    def later(self, now: float, clock: Clock) -> Callable[[FloatArray], FloatArray]:
        """Return the function that takes keys' frames to their new frames."""
        change = self._later_s(float(clock.time_s(np.array(now))))
        return lambda frames: clock.frame(change(clock.time_s(frames)))

    def _later_s(self, now: float) -> Callable[[FloatArray], FloatArray]:
        if self.mode == "DELAY":
            return lambda old: old + self.seconds
        if self.mode == "SPEED":
            return lambda old: np.where(old > now, now + (old - now) / self.speed, old)
        first, last = self.first_s, self.last_s
        longer = (last - first) * (1 / self.speed - 1)
        return lambda old: old + longer * np.clip((old - first) / (last - first), 0, 1)


CLASSES = (UNISIM_OT_retime_actor,)
