"""Operators of the gizmos in the 3D view: they drag the ego vehicle's lane, an actor's trajectory and its speed, a
sensor's direction.

Each is one undo step, Esc or the right mouse button puts everything back, and `execute` does with numbers what dragging
does.
"""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np
from bpy.props import FloatProperty, FloatVectorProperty
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Vector

from ...bridge.changes.handles import TransformSnapshot, displace_at
from ...bridge.changes.motion import displaced_along, respeeded
from ...bridge.objects.imported import class_of, drive_of, imported_objects, source_of
from ...bridge.objects.sensors import aim, base_of, direction_of, is_keyed
from ...bridge.objects.trajectories import keyed_pose, own_trajectory, trajectory_of
from ...bridge.window import Need, object_mode, refresh, vehicle
from ...core.errors import UnisimError
from ...core.geometry import FloatArray
from ...editing.edits.lines import metres
from ...editing.layout.speed_graph import axes_of, speed_of
from ...editing.motion.braking import speed_at
from ...editing.motion.keys import BLEND_S, along_axis, on_plane, stepped
from ...editing.motion.kinematics import describe, is_limited
from ...editing.motion.retiming import instant
from ...editing.sampled.clock import Clock
from ...editing.sensors.mounts import angles
from ...editing.texts import Text, kmh, series, translatable
from ...translations import interface, localized, message, tooltip
from ..operator_bases import EditsObjects, Needing, in_m_s, in_metres, in_seconds
from ..problems import fail
from .overlay import Grip, graph_place, grips
from .properties import graph_of, limits_of

CLICK_PX = 3
"""Moving the mouse by less is a click, which is meant for what lies under the gizmo."""
STEP_M, STEP_DEG, STEP_M_S = 0.5, 5.0, 5 / 3.6
"""Steps while Ctrl is held."""
WHEEL = 1.2
"""By which factor a turn of the wheel changes how far a drag reaches."""
LEAST_M_S2 = 0.1
"""Smaller accelerations are not told."""
HINT = translatable("{done}  |  Ctrl: steps, Esc: cancel")
TARGET_M = 5.0
"""Distance of the handle that turns a sensor from it, in metres."""
VIEW_AXIS = Vector((0.0, 0.0, 1.0))
"""Out of the screen, in a view's axes."""
UP = np.array([0.0, 0.0, 1.0])


def moving_actor(context: bpy.types.Context) -> Need:
    """An actor with a trajectory is active."""
    obj = context.active_object
    met = obj is not None and obj.unisim.kind == "ACTOR" and trajectory_of(obj) is not None
    return met, "Make a moving actor active first: use G for actors that do not move"


def active_sensor(context: bpy.types.Context) -> Need:
    """A camera or a LiDAR of the drive is active."""
    obj = context.active_object
    return obj is not None and obj.unisim.kind in ("CAMERA", "LIDAR"), "Make a camera or a LiDAR active first"


class Dragged:
    """An operator that a gizmo starts: it follows the mouse until the button is let go.

    A kind of it says in `subject` what it moves, in `apply` what its properties mean, in `follow` which properties the
    mouse stands for, and in `said` what the header shows.
    """

    bl_options = {"REGISTER", "UNDO", "INTERNAL", "BLOCKING"}

    def subject(self: Any, context: bpy.types.Context) -> bpy.types.Object:
        """Return the object that is moved."""
        return context.active_object

    def subjects(self: Any, context: bpy.types.Context) -> list[bpy.types.Object]:
        """Return what is changed with it, itself among it."""
        return [self.subject(context)]

    def note(self: Any, context: bpy.types.Context) -> None:
        """Note what is there before anything moves, by the mouse or by the operator's numbers."""

    def begin(self: Any, context: bpy.types.Context) -> None:
        """Note what has to be known before the mouse moves anything, as ``origin`` (3,) the place that it drags."""

    def clock(self: Any, context: bpy.types.Context) -> Clock:
        """Return the drive's clock."""
        return Clock.of(source_of(context.scene).drive)

    def dragged(
        self: Any, context: bpy.types.Context, pressed: FloatArray, mouse: FloatArray, normal: FloatArray = UP
    ) -> FloatArray | None:
        """Return by how much (3,) the mouse moved in a plane through the origin, by default that of the ground; None where
        it does not point at it."""
        first, now = (on_plane(*ray(context, at), self.origin, normal) for at in (pressed, mouse))
        return None if first is None or now is None else now - first

    def execute(self: Any, context: bpy.types.Context) -> set[str]:
        try:
            self.note(context)
            self.apply(context)
        except (UnisimError, OSError, ValueError) as fault:
            return fail(self, fault)
        refresh([self.subject(context)])
        self.report({"INFO"}, localized(self.said(context)))
        return {"FINISHED"}

    def invoke(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.pressed, self.moved = (event.mouse_region_x, event.mouse_region_y), False
        self.starts = [(obj, TransformSnapshot.of(obj)) for obj in self.subjects(context)]
        try:
            self.note(context)
            self.begin(context)
        except (UnisimError, OSError) as fault:
            return fail(self, fault)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Move it where the mouse is, let go of it, or put it back."""
        if event.type in ("ESC", "RIGHTMOUSE"):
            return self.put_back(context)
        mouse = event.mouse_region_x, event.mouse_region_y
        self.moved = self.moved or max(abs(mouse[0] - self.pressed[0]), abs(mouse[1] - self.pressed[1])) >= CLICK_PX
        if (event.type == "MOUSEMOVE" or self.turned(event)) and self.moved:
            self.restore()
            self.follow(context, np.array(self.pressed, float), np.array(mouse, float), event.ctrl)
            self.apply(context)
            refresh([self.subject(context)])
            context.area.header_text_set(interface(self.hint, done=self.said(context)))
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            if not self.moved:
                self.put_back(context)
                bpy.ops.view3d.select("INVOKE_DEFAULT", True, location=mouse)
                return {"CANCELLED"}
            self.let_go(context)
            self.report({"INFO"}, localized(self.said(context)))
            return {"FINISHED"}
        return {"RUNNING_MODAL"}

    hint = HINT

    def turned(self: Any, event: bpy.types.Event) -> bool:
        """Take a turn of the mouse wheel; return whether it means anything."""
        return False

    def restore(self: Any) -> None:
        """Put everything back where it stood."""
        for obj, start in self.starts:
            start.restore(obj)

    def let_go(self: Any, context: bpy.types.Context) -> None:
        """End what shows that it is dragged."""
        context.area.header_text_set(None)

    def put_back(self: Any, context: bpy.types.Context) -> set[str]:
        """Put it back where it stood."""
        if self.moved:
            self.restore()
            refresh([self.subject(context)])
        self.let_go(context)
        return {"CANCELLED"}

    def cancel(self: Any, context: bpy.types.Context) -> None:
        """Called by Blender where it ends the operator itself."""
        self.put_back(context)


class UNISIM_OT_drag_ego(Needing, Dragged, bpy.types.Operator):
    """Drag the ego vehicle with its sensors sideways into another lane, alike at every time"""

    bl_label = "Shift Ego Lane"
    needs = (object_mode, vehicle)

    left_m: in_metres("Left", "Negative: to the right")

    def subject(self, context: bpy.types.Context) -> bpy.types.Object:
        return next(imported_objects(context.scene, "EGO"))

    def begin(self, context: bpy.types.Context) -> None:
        world = np.array(self.subject(context).matrix_world, float)
        self.origin, self.left = world[:3, 3], world[:3, 1] / np.linalg.norm(world[:3, 1])

    def follow(self, context: bpy.types.Context, pressed: FloatArray, mouse: FloatArray, in_steps: bool) -> None:
        first, now = (along_axis(*ray(context, at), self.origin, self.left) for at in (pressed, mouse))
        self.left_m = stepped(now - first, STEP_M, in_steps)

    def apply(self, context: bpy.types.Context) -> None:
        displaced_along(self.subject(context), (0.0, self.left_m, 0.0))

    def said(self, context: bpy.types.Context) -> str:
        length = abs(self.left_m)
        shift = Text("{length} to the left" if self.left_m >= 0 else "{length} to the right", length=metres(length))
        return Text("Shift ego lane: {shift}", shift=shift)


class UNISIM_OT_drag_trajectory(Needing, Dragged, bpy.types.Operator):
    """Drag the active actor's trajectory at this time in the ground plane; the change blends in and out over two seconds"""

    bl_label = "Displace Trajectory"
    needs = (object_mode, moving_actor)

    time_s: in_seconds("At", "In seconds of the log")
    offset_m: FloatVectorProperty(
        name="Offset", description="In the world's axes", subtype="XYZ_LENGTH", unit="LENGTH", options={"SKIP_SAVE"}
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        name = context.active_object.name if context.active_object is not None else Text("the active actor")
        drive, time_s = drive_of(context.scene), properties.time_s
        when = f"{time_s:.2f} s" if drive is None else instant(time_s, Clock.of(drive))
        return tooltip(
            "Drag to displace {name} at {time} in the ground plane; the change blends in and out over 2 s on both sides",
            name=name, time=when,
        )  # fmt: skip

    def begin(self, context: bpy.types.Context) -> None:
        frame = float(self.clock(context).frame(np.array(self.time_s)))
        self.origin = keyed_pose(self.subject(context), frame)[:3, 3]

    def follow(self, context: bpy.types.Context, pressed: FloatArray, mouse: FloatArray, in_steps: bool) -> None:
        moved = self.dragged(context, pressed, mouse)
        if moved is not None:
            self.offset_m = [stepped(float(apart), STEP_M, in_steps) for apart in moved]

    def apply(self, context: bpy.types.Context) -> None:
        displace_at(self.subject(context), self.time_s, np.array(self.offset_m), self.clock(context))

    def said(self, context: bpy.types.Context) -> str:
        away = float(np.linalg.norm(self.offset_m))
        when = instant(self.time_s, self.clock(context))
        return Text("{name}: {length:.2f} m at {time}", name=self.subject(context).name, length=away, time=when)


class UNISIM_OT_drag_speed(Needing, Dragged, bpy.types.Operator):
    """Drag the active actor's speed at this time; it stays on its path, and speeds before and after it blend in and out"""

    bl_label = "Change Speed"
    needs = (object_mode, moving_actor)

    time_s: in_seconds("At", "In seconds of the log")
    speed_m_s: in_m_s("Speed", "Speed at this time", min=0.0)
    reach_s: in_seconds(
        "Falloff", "Time before and after it in which the speed changes, less and less", BLEND_S,
        once=False, min=0.3, max=20.0,
    )  # fmt: skip
    hint = translatable("{done}  |  Ctrl: steps, wheel: falloff, Esc: cancel")

    def subjects(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        return [obj for obj in (self.subject(context), own_trajectory(self.subject(context))) if obj is not None]

    def begin(self, context: bpy.types.Context) -> None:
        place = graph_place(context)
        time_s = place.time_at(*self.pressed, math.inf) if place is not None else None
        if place is None or time_s is None:
            raise UnisimError(message("show the speed graph first"))
        self.scale, self.axes = place.scale, axes_of(place.graph)
        self.time_s, self.before_m_s = time_s, float(speed_of(place.graph, time_s))
        self.speed_m_s = self.before_m_s
        self.mark(context)

    def turned(self, event: bpy.types.Event) -> bool:
        factor = {"WHEELUPMOUSE": 1 / WHEEL, "WHEELDOWNMOUSE": WHEEL}.get(event.type, 1.0)
        self.reach_s *= factor
        return factor != 1.0

    def follow(self, context: bpy.types.Context, pressed: FloatArray, mouse: FloatArray, in_steps: bool) -> None:
        speed = self.before_m_s + self.axes.speed_m_s(float(mouse[1] - pressed[1]) / self.scale)
        self.speed_m_s = max(stepped(speed, STEP_M_S, in_steps), 0.0)
        self.mark(context)

    def mark(self, context: bpy.types.Context) -> None:
        """Show where it is dragged, on the axes that were there at first."""
        obj, drive = self.subject(context), source_of(context.scene).drive
        limit = limits_of(context.scene).acceleration_m_s2 if is_limited(class_of(obj, drive)) else 0.0
        grips["drag"] = Grip(self.time_s, self.reach_s, limit, self.axes.top_m_s, self.speed_m_s)

    def let_go(self, context: bpy.types.Context) -> None:
        grips.clear()
        super().let_go(context)

    def apply(self, context: bpy.types.Context) -> None:
        args = self.time_s, self.speed_m_s, self.reach_s, self.clock(context)
        respeeded(self.subject(context), lambda keys: speed_at(keys, *args), args[-1])

    def said(self, context: bpy.types.Context) -> str:
        """Return what is done, and how hard it brakes or speeds up around it."""
        clock = self.clock(context)
        words: list[str] = [Text("{speed} at {time}", speed=kmh(self.speed_m_s), time=instant(self.time_s, clock))]
        graph = graph_of(context)
        if graph is not None:
            near = np.abs(clock.times_s - self.time_s) <= self.reach_s
            values = np.nan_to_num(graph.now.acceleration_m_s2[near])
            if len(values) and np.abs(values).max() > LEAST_M_S2:
                words.append(describe("acceleration_m_s2", float(values[np.abs(values).argmax()])))
        return series([self.subject(context).name, series(words)], ": ")


class _Aimed(Needing):
    """Yaw and pitch of a sensor in the vehicle's axes."""

    needs = (
        object_mode,
        active_sensor,
        lambda context: (
            not is_keyed(context.active_object),
            "Keyframes rotate this sensor: edit them in the Graph Editor, or delete them",
        ),
    )

    yaw_deg: FloatProperty(
        name="Yaw", description="Degrees to the left of the vehicle's axis", soft_min=-180, soft_max=180
    )
    pitch_deg: FloatProperty(name="Pitch", description="Degrees up", soft_min=-89, soft_max=89)

    def apply(self: Any, context: bpy.types.Context) -> None:
        aim(context.active_object, np.radians(self.yaw_deg), np.radians(self.pitch_deg))

    def said(self: Any, context: bpy.types.Context) -> str:
        yaw = Text("{angle:.1f}° left" if self.yaw_deg >= 0 else "{angle:.1f}° right", angle=abs(self.yaw_deg))
        pitch = Text("{angle:.1f}° up" if self.pitch_deg >= 0 else "{angle:.1f}° down", angle=abs(self.pitch_deg))
        return Text("{name}: looks {yaw}, {pitch}", name=context.active_object.name, yaw=yaw, pitch=pitch)


class UNISIM_OT_aim_sensor(_Aimed, EditsObjects, bpy.types.Operator):
    """Turn the active camera or LiDAR on its mount, by yaw and pitch from the vehicle's axis"""

    bl_label = "Aim Sensor"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.yaw_deg, self.pitch_deg = np.degrees(direction_of(context.active_object))
        return context.window_manager.invoke_props_dialog(self)

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        self.apply(context)
        self.report({"INFO"}, localized(self.said(context)))
        return [context.active_object]


class UNISIM_OT_drag_aim(_Aimed, Dragged, bpy.types.Operator):
    """Drag to aim the active sensor: its mount rotates by yaw and pitch"""

    bl_label = "Aim Sensor"

    def begin(self, context: bpy.types.Context) -> None:
        obj = self.subject(context)
        self.place, self.base = np.array(obj.matrix_world.translation, float), base_of(obj)
        self.before = direction_of(obj)
        self.origin = target_of(obj)

    def follow(self, context: bpy.types.Context, pressed: FloatArray, mouse: FloatArray, in_steps: bool) -> None:
        """Set the angles to those of the handle, dragged in the plane that faces the view."""
        facing = np.array(context.region_data.view_rotation @ VIEW_AXIS, float)
        moved = self.dragged(context, pressed, mouse, facing)
        if moved is None:
            return
        yaw, pitch = angles(self.base.T @ (self.origin + moved - self.place))
        self.yaw_deg, self.pitch_deg = (stepped(float(np.degrees(a)), STEP_DEG, in_steps) for a in (yaw, pitch))


def target_of(obj: bpy.types.Object) -> FloatArray:
    """Return the place (3,) that lies `TARGET_M` ahead of a sensor."""
    yaw, pitch = direction_of(obj)
    ahead = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
    return np.array(obj.matrix_world.translation, float) + TARGET_M * base_of(obj) @ ahead


def ray(context: bpy.types.Context, mouse: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return origin (3,) and direction (3,) of the ray under the mouse in a 3D view."""
    args = context.region, context.region_data, mouse.tolist()
    return np.array(region_2d_to_origin_3d(*args), float), np.array(region_2d_to_vector_3d(*args), float)
