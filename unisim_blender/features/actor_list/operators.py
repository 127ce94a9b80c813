"""Operators of the actor list and the presence timeline, and the filter of both."""

import math
from dataclasses import replace

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty
from mathutils import Euler

from ...bridge.objects.imported import drive_of, imported_objects
from ...bridge.window import choose, drive, object_mode
from ...editing.actors.table import ActorFilter, nearest_present
from ...editing.sampled.clock import Clock
from ...editing.texts import translatable
from ...translations import message
from ..operator_bases import Editing, Needing
from ..sidebar import switch_of
from . import listing

GROUPS = (
    ("ALL", "All", "Actors of every class", "GROUP", 0),
    ("CAR", "Cars", "Cars and pickup trucks", "AUTO", 1),
    ("TRUCK", "Trucks and buses", "Trucks, buses, construction and emergency vehicles, trailers", "PACKAGE", 2),
    ("PERSON", "People", "Pedestrians", "USER", 3),
    ("CYCLE", "Two-wheelers", "Bicycles, motorcycles, scooters", "MOD_INSTANCE", 4),
    ("OTHER", "Others", "Cones, signs, animals and the rest", "CONE", 5),
)
ICONS = {name: icon for name, _, _, icon, _ in GROUPS}
ORDERS = (
    ("NAME", "Name", "By name, numbers by their value", "SORTALPHA", 0),
    ("DISTANCE", "Distance", "Nearest to the ego vehicle first, absent actors last", "DRIVER_DISTANCE", 1),
    ("TIME", "Time", "Earliest first", "TIME", 2),
)
TILT_RAD = math.radians(62)
"""A view that leaves its camera for an actor looks along the street from behind and above, so far
from straight down."""
VIEW_M, FAR_M = 25.0, 60.0
"""Its distance from the actor; a view that was free keeps its own, up to the second."""
NEAR_M = 50.0
"""The distance that the filter begins with."""


def changed(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """The filter is another one."""
    self.scroll = 0
    listing.refilter()


def active_place(self: bpy.types.PropertyGroup) -> int:
    """Return which of the scene's objects is the active actor; -1 where none is."""
    obj = bpy.context.view_layer.objects.active if bpy.context.view_layer is not None else None
    if obj is None or obj.unisim.kind != "ACTOR" or not obj.select_get():
        return -1
    return listing.table_of(bpy.context.scene).places.get(obj.session_uid, -1)


def choose_place(self: bpy.types.PropertyGroup, place: int) -> None:
    """A row was clicked."""
    objects = bpy.context.scene.objects
    if 0 <= place < len(objects):
        bpy.ops.unisim.choose_actor("EXEC_DEFAULT", True, name=objects[place].name)


class UniSimActorList(bpy.types.PropertyGroup):
    """The filter of the actor list and the presence timeline, and what a click does. It belongs to the session, not to
    the file: undo does not change it."""

    text: StringProperty(
        name="Name", description="Part of a name or a class", options={"TEXTEDIT_UPDATE", "SKIP_SAVE"}, update=changed
    )
    group: EnumProperty(name="Class", description="Classes that are listed", items=GROUPS, update=changed)
    within_m: FloatProperty(
        name="Within", description="Only actors within this distance of the ego vehicle at the current frame",
        min=0.0, soft_max=200.0, step=500, precision=0, unit="LENGTH", update=changed,
    )  # fmt: skip
    is_near: switch_of(
        "within_m",
        lambda self: NEAR_M,
        "Within",
        "Only actors within a distance of the ego vehicle at the current frame",
    )
    now: BoolProperty(
        name="Present Now", description="Only actors that are present at the current frame", update=changed
    )
    edited: BoolProperty(name="Edited", description="Only actors that were added, removed or edited", update=changed)
    order: EnumProperty(name="Sort by", description="Order of the list", items=ORDERS, update=changed)
    jump: BoolProperty(
        name="Jump to Its Time",
        description="A click goes to the nearest frame at which the actor is there",
        default=True,
    )
    frame: BoolProperty(
        name="Turn the View",
        description="A click turns the view to the actor; a view through a camera that has it in its image stays",
        default=True,
    )
    scroll: IntProperty(name="First row", description="First row of the presence timeline", min=0)
    place: IntProperty(get=active_place, set=choose_place)


class UNISIM_OT_choose_actor(Needing, bpy.types.Operator):
    """Select an actor and make it active"""

    bl_label = "Select Actor"
    bl_options = {"UNDO", "INTERNAL"}
    needs = (object_mode, drive)

    name: StringProperty(name="Actor", description="The object's name")
    seconds: FloatProperty(
        name="Time", description="Seconds of the drive to go to; below 0: as the list's settings have it", default=-1.0
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Select it, go to a frame at which it is there, and turn the view to it."""
        scene, about = context.scene, context.window_manager.unisim_actors
        obj = scene.objects.get(self.name)
        if obj is None or obj.unisim.kind != "ACTOR":
            self.report({"WARNING"}, message('"{name}" is not there any more', name=self.name))
            return {"CANCELLED"}
        frame = frame_to_show(context, obj, self.seconds, about.jump)
        if frame is not None and frame != scene.frame_current:
            scene.frame_set(frame)
        if obj.name not in context.view_layer.objects:
            self.report(
                {"WARNING"}, message('"{name}" is in a collection that this view layer leaves out', name=self.name)
            )
            return {"CANCELLED"}
        choose(context, obj)
        context.view_layer.objects.active = obj
        if not obj.visible_get():
            sentence = translatable('"{name}" is active, but not there at this time')
            if obj.hide_get():
                sentence = translatable('"{name}" is active, but hidden in the view: its eye in the list shows it')
            self.report({"INFO"}, message(sentence, name=obj.name))
        elif about.frame and self.seconds < 0:
            turn_to(context, obj)
        return {"FINISHED"}


def frame_to_show(context: bpy.types.Context, obj: bpy.types.Object, seconds: float, jump: bool) -> int | None:
    """Return the frame to go to for an actor: that of ``seconds`` where they are not negative, else the nearest at
    which it is there; None where the frame stays."""
    scene, drive = context.scene, drive_of(context.scene)
    if drive is None:
        return None
    clock = Clock.of(drive)
    if seconds >= 0:
        return int(round(float(clock.frame(np.array(seconds)))))
    entry = listing.table_of(scene).entries.get(obj.session_uid)
    if not jump or entry is None or entry.there:
        return None
    time_s = nearest_present(entry, float(clock.time_s(scene.frame_current_final)))
    return None if time_s is None else int(round(float(clock.frame(np.array(time_s)))))


def turn_to(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Turn the 3D view to an actor; a view through a camera that has the actor in its image stays."""
    area = context.area if context.area is not None and context.area.type == "VIEW_3D" else None
    looks = area.spaces.active.region_3d if area is not None else None
    if looks is None or (looks.view_perspective == "CAMERA" and in_image(context.scene, obj)):
        return
    if looks.view_perspective == "CAMERA":
        ego = next(imported_objects(context.scene, "EGO"), None)
        heading = ego.matrix_world.to_euler().z if ego is not None else 0.0
        looks.view_perspective = "PERSP"
        looks.view_rotation = Euler((TILT_RAD, 0.0, heading - math.pi / 2)).to_quaternion()
        looks.view_distance = VIEW_M
    looks.view_location = obj.matrix_world.translation
    looks.view_distance = min(looks.view_distance, FAR_M)


def in_image(scene: bpy.types.Scene, obj: bpy.types.Object) -> bool:
    """Return whether the scene's camera has an actor's middle in its image."""
    from bpy_extras.object_utils import world_to_camera_view

    if scene.camera is None:
        return False
    x, y, away = world_to_camera_view(scene, scene.camera, obj.matrix_world.translation)
    return 0 <= x <= 1 and 0 <= y <= 1 and away > 0


class UNISIM_OT_hide_actor(bpy.types.Operator):
    """Hide or show an actor in the view; images and sweeps are not affected"""

    bl_label = "Hide Actor in the View"
    bl_options = {"UNDO", "INTERNAL"}

    name: StringProperty(name="Actor", description="The object's name")

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = context.view_layer.objects.get(self.name)
        if obj is None:
            self.report({"WARNING"}, message('"{name}" is not in this view layer', name=self.name))
            return {"CANCELLED"}
        obj.hide_set(not obj.hide_get())
        return {"FINISHED"}


def is_filtered(manager: bpy.types.WindowManager) -> bool:
    """Return whether the list leaves actors out."""
    return replace(listing.filter_of(manager), order="NAME") != ActorFilter()


class UNISIM_OT_clear_actor_filter(Needing, bpy.types.Operator):
    """List all actors again"""

    bl_label = "Clear Filter"
    bl_options = {"INTERNAL"}
    needs = (lambda context: (is_filtered(context.window_manager), "All actors are listed already"),)

    def execute(self, context: bpy.types.Context) -> set[str]:
        about = context.window_manager.unisim_actors
        about.text, about.group, about.within_m, about.now, about.edited = "", "ALL", 0.0, False, False
        return {"FINISHED"}


class UNISIM_OT_select_listed(Editing, bpy.types.Operator):
    """Select all actors that are listed and visible in the view"""

    bl_label = "Select Listed"
    needs = (
        object_mode,
        drive,
        lambda context: (listing.table_of(context.scene).shown, "No actor is listed: clear the filter"),
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        keys = {entry.key for entry in listing.refresh_now(context.scene).shown}
        actors = [
            obj for obj in imported_objects(context.scene, "ACTOR") if obj.session_uid in keys and obj.visible_get()
        ]
        choose(context, *actors)
        said = translatable("{number} of {count} listed actors are visible and selected")
        self.report({"INFO"}, message(said, number=len(actors), count=len(keys)))
        return {"FINISHED"}


PROPERTIES = ((bpy.types.WindowManager, "unisim_actors", PointerProperty(type=UniSimActorList)),)
