"""Trajectories of actors: along a curve, on the ground, retimed, shifted."""

from typing import Any

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty

from ...bridge.changes.maneuvers import Maneuvering
from ...bridge.changes.motion import displaced_along, follow, respeeded, retimed, shift
from ...bridge.objects.imported import class_of, drive_of, source_of
from ...bridge.objects.meshes import size_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.window import Need, chosen, counted_names, object_mode, selected
from ...core.errors import UnisimError
from ...core.geometry import FloatArray
from ...core.world.drive import Drive
from ...editing.motion.braking import Approach, Habits, habits_of, other_speed
from ...editing.motion.kinematics import describe
from ...editing.motion.plausibility import ground_height
from ...editing.motion.retiming import Retiming, followed, followed_briefly, later_or_earlier
from ...editing.sampled.clock import Clock
from ...editing.texts import UPPER, cased, series
from ...translations import localized, message
from ..operator_bases import EditsObjects, draw_split, in_m_s, in_m_s2, in_metres, in_seconds

BRAKING = (
    ("COMFORTABLE", "Comfortable", "As actors of this class brake ordinarily"),
    ("EMERGENCY", "Emergency", "As hard as actors of this class can brake"),
    ("CUSTOM", "Custom", "At a given deceleration"),
)


class FromTime:
    """Base of operators that begin at a time of the log: the current frame's, unless it is given."""

    first_s: in_seconds("From", "Start time, in seconds of the log")

    def start_at(self: Any, scene: bpy.types.Scene, clock: Clock) -> None:
        """Keep the current frame's time, so that the operator done again does the same, whichever frame is shown."""
        if not self.properties.is_property_set("first_s"):
            self.first_s = float(clock.time_s(np.array(frame_of(scene))))

    def start_s(self: Any, clock: Clock) -> float:
        """Return the time; that of a frame exactly, where it is a frame's."""
        frame = float(clock.frame(np.array(self.first_s)))
        return float(clock.time_s(np.array(round(frame)))) if abs(frame - round(frame)) < 1e-3 else self.first_s


class Braking:
    """Base of operators that let actors brake."""

    braking: EnumProperty(name="Braking", description="How hard the actor brakes", items=BRAKING)
    deceleration_m_s2: in_m_s2(
        "Deceleration", "Deceleration while it brakes; other speeds are also sped up to by it", 2.0,
        once=False, min=0.1, soft_max=10.0,
    )  # fmt: skip

    def deceleration_of(self: Any, habits: Habits) -> float:
        """Return the deceleration of an actor."""
        if self.braking == "CUSTOM":
            return float(self.deceleration_m_s2)
        return habits.emergency_m_s2 if self.braking == "EMERGENCY" else habits.comfortable_m_s2

    def draw_braking(self: Any, habits: Habits) -> None:
        """Draw how hard the active actor brakes."""
        self.layout.prop(self, "braking")
        if self.braking == "CUSTOM":
            self.layout.prop(self, "deceleration_m_s2")
        else:
            said = cased(describe("acceleration_m_s2", -self.deceleration_of(habits)), UPPER)
            self.layout.label(text=localized(said), translate=False)


def actor_habits(obj: bpy.types.Object, drive: Drive) -> Habits:
    """Return how an actor of its class moves."""
    return habits_of(class_of(obj, drive))


def curve_line(context: bpy.types.Context, curve: bpy.types.Object) -> FloatArray:
    """Return the points (P, 3) of a curve in the world."""
    evaluated = curve.evaluated_get(context.evaluated_depsgraph_get())
    line = np.array([curve.matrix_world @ vertex.co for vertex in evaluated.to_mesh().vertices], float)
    evaluated.to_mesh_clear()
    return line


def one_curve(context: bpy.types.Context) -> Need:
    """One curve is selected."""
    curves = [obj for obj in context.selected_objects if obj.type == "CURVE"]
    return len(curves) == 1, "Select one curve in addition to the actors (Add > Curve)"


class UNISIM_OT_follow_curve(FromTime, Braking, EditsObjects, bpy.types.Operator):
    """Move the selected actors along the selected curve, from a time on, and stop them at its end"""

    bl_label = "Follow Curve"
    needs = (object_mode, selected("Select an actor first", "ACTOR"), one_curve)

    speed_m_s: in_m_s("Speed", "Speed along the curve, until it brakes to stop at the end", 8.0, min=0.1, soft_max=40.0)
    length_m: FloatProperty(unit="LENGTH", options={"HIDDEN", "SKIP_SAVE"})

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings, and how long the curve takes in seconds and frames."""
        self.layout.prop(self, "first_s")
        self.layout.prop(self, "speed_m_s")
        drive = drive_of(context.scene)
        if drive is None:
            return
        habits, clock = actor_habits(chosen(context, "ACTOR")[0], drive), Clock.of(drive)
        self.draw_braking(habits)
        for line in followed(self.way(habits), self.start_s(clock), clock):
            self.layout.label(text=localized(line), translate=False)

    def way(self, habits: Habits) -> Approach:
        """Return the way of an actor along the curve."""
        return Approach(self.length_m, self.speed_m_s, self.deceleration_of(habits))

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """Keys along the curve; the actors' undersides are on it."""
        curve = next(obj for obj in context.selected_objects if obj.type == "CURVE")
        line = curve_line(context, curve)
        self.length_m = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
        if len(line) < 2 or self.length_m == 0:
            raise UnisimError(message('curve "{name}" has fewer than two points', name=curve.name))
        drive, actors = source_of(context.scene).drive, chosen(context, "ACTOR")
        clock, habits = Clock.of(drive), [actor_habits(obj, drive) for obj in actors]
        self.start_at(context.scene, clock)
        if not self.properties.is_property_set("speed_m_s"):
            self.speed_m_s = min(each.speed_m_s for each in habits)
        for obj, each in zip(actors, habits, strict=True):
            follow(obj, line, self.start_s(clock), self.way(each), clock)
        done = followed_briefly(self.way(habits[0]), self.start_s(clock), clock)
        self.report({"INFO"}, localized(series([counted_names(actors), done], ": ")))
        return actors


class UNISIM_OT_snap_to_ground(EditsObjects, bpy.types.Operator):
    """Place the selected actors and static items on the ground below them, at the current frame"""

    bl_label = "Snap to Ground"
    needs = (object_mode, selected("Select an actor or a static item first", "ACTOR", "STATIC"))

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """Up or down along the box's own axis."""
        source = source_of(context.scene)
        for obj in chosen(context, "ACTOR", "STATIC"):
            now = np.array(obj.matrix_world, float)
            low = now[:3, 3] - now[:3, 2] / np.linalg.norm(now[:3, 2]) * float(size_of(obj)[2]) / 2
            ground = ground_height(source, low, context.scene.frame_current)
            if ground is None:
                self.report({"WARNING"}, message("{name}: the ground height is unknown there", name=obj.name))
            else:
                displaced_along(obj, (0.0, 0.0, ground - low[2]))
        return chosen(context, "ACTOR", "STATIC")


MODES = (
    ("DELAY", "Delay", "Delay the whole trajectory"),
    ("SPEED", "Speed", "Change the speed from a time on"),
    ("STOP", "Stop and go", "Brake from a time on, stand, then continue"),
    ("STRETCH", "Stretch", "Change the speed between two times; later keyframes shift accordingly"),
)
STRETCH_S = 4.0
"""Default length of what is stretched, in which cars can brake to half of their speed."""
HARDER = 1.2
"""From this factor of what was asked for on, the report says how hard actors brake or speed up."""
NEEDED = {
    "DELAY": ("seconds",),
    "SPEED": ("first_s", "speed"),
    "STOP": ("first_s", "seconds"),
    "STRETCH": ("first_s", "last_s", "speed"),
}


class UNISIM_OT_retime_actor(FromTime, Braking, EditsObjects, bpy.types.Operator):
    """Change when the selected actors are where on their trajectories"""

    bl_label = "Retime Actor"
    needs = (object_mode, selected("Select an actor first", "ACTOR"))

    mode: EnumProperty(name="Mode", description="Kind of time change", items=MODES, default="DELAY")
    seconds: in_seconds("Seconds", "Delay or duration of the stop, in seconds of the log", 0.5, once=False)
    speed: FloatProperty(name="Speed", description="Factor of the original speed", default=0.5, min=0.01, soft_max=4.0)
    last_s: in_seconds("To", "End time, in seconds of the log", 2.0)

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "mode")
        for name in NEEDED[self.mode]:
            self.layout.prop(self, name)
        drive = drive_of(context.scene)
        if drive is None:
            return
        if self.mode != "DELAY":
            self.draw_braking(actor_habits(chosen(context, "ACTOR")[0], drive))
        for line in self.retiming(Clock.of(drive)).lines(Clock.of(drive)):
            self.layout.label(text=localized(line), translate=False)

    def retiming(self, clock: Clock) -> Retiming:
        """Return the change as it is set."""
        return Retiming(self.mode, self.seconds, self.speed, self.start_s(clock), self.last_s)

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        drive, actors = source_of(context.scene).drive, chosen(context, "ACTOR")
        clock = Clock.of(drive)
        self.start_at(context.scene, clock)
        if not self.properties.is_property_set("last_s"):
            self.last_s = self.first_s + STRETCH_S
        retiming = self.retiming(clock)
        if self.mode == "STRETCH" and self.first_s >= self.last_s:
            raise UnisimError(
                message("From ({first:g} s) must be earlier than To ({last:g} s)", first=self.first_s, last=self.last_s)
            )
        hardest = max(self.retime(obj, retiming, drive, clock) for obj in actors)
        done = [retiming.summary(clock)]
        if hardest > HARDER * self.deceleration_of(actor_habits(actors[0], drive)):
            done.append(describe("acceleration_m_s2", hardest if self.speed > 1 else -hardest))
        self.report({"INFO"}, localized(series([counted_names(actors), series(done)], ": ")))
        return actors

    def retime(self, obj: bpy.types.Object, retiming: Retiming, drive: Drive, clock: Clock) -> float:
        """Move an actor's keys, and return by how much it brakes or speeds up at most."""
        habits = actor_habits(obj, drive)
        hard = gently = self.deceleration_of(habits)
        if self.braking != "CUSTOM" or self.mode == "STOP":
            gently = min(hard, habits.comfortable_m_s2)
        first_s, last_s = retiming.first_s, self.last_s if self.mode == "STRETCH" else None
        if self.mode == "STOP":
            numbers = {
                "at_s": first_s,
                "deceleration_m_s2": hard,
                "stands_s": abs(self.seconds),
                "acceleration_m_s2": gently,
            }
            values = {"type": "brake", **{name: round(value, 5) for name, value in numbers.items()}}
            Maneuvering.of(obj.users_scene[0], obj).apply(values)
            return 0.0
        change = None
        if self.mode != "DELAY":
            speed = self.speed
            change = respeeded(obj, lambda keys: other_speed(keys, first_s, last_s, speed, hard, gently, clock), clock)
        if change is None:
            retimed(obj, retiming.frames(clock))
        return 0.0 if change is None else change.hardest_m_s2


class UNISIM_OT_shift_actor(EditsObjects, bpy.types.Operator):
    """Shift the selected actors sideways, along the path of their trajectory and in time, alike at every time"""

    bl_label = "Shift Actor"
    needs = (object_mode, selected("Select an actor first", "ACTOR"))

    left_m: in_metres(
        "Sideways", "Shift to the left of the actor; negative values shift to the right", 1.0,
        once=False, soft_min=-10.0, soft_max=10.0,
    )  # fmt: skip
    ahead_m: in_metres(
        "Along Path",
        "Forward by this length of the trajectory's path, round its turns, and straight on beyond its ends; "
        "actors that do not move are shifted along their own axis; negative values shift backward",
        once=False, soft_min=-50.0, soft_max=50.0,
    )  # fmt: skip
    later_s: in_seconds(
        "Later", "Shift in time in seconds of the log, including when the actor is present; negative values shift earlier",
        once=False, soft_min=-10.0, soft_max=10.0,
    )  # fmt: skip

    def draw(self, context: bpy.types.Context) -> None:
        draw_split(self, "left_m", "ahead_m", "later_s")
        drive = drive_of(context.scene)
        if drive is not None:
            self.layout.label(text=localized(later_or_earlier(self.later_s, Clock.of(drive))), translate=False)

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        drive = source_of(context.scene).drive
        actors = chosen(context, "ACTOR")
        said = [sentence for obj in actors if (sentence := shift(obj, self.left_m, self.ahead_m, self.later_s, drive))]
        summary = localized(said[0]) if said else message("Nothing is shifted: all amounts are 0")
        if len(said) > 1:
            summary = message("{sentence} (and {count} more)", sentence=summary, count=len(said) - 1)
        self.report({"INFO"}, summary)
        return actors
