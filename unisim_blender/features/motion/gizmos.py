"""Gizmos in the 3D view: an arrow for the ego vehicle's lane, handles on a trajectory, the curve of the speed graph, a
handle for a sensor's direction.

They start the operators of `operators.drag`, which do the work. In a view through a camera of the drive they are off,
as they would lie over the image, unless Gizmos > In Recorded Views says otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, ClassVar

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Matrix, Vector
from mathutils.geometry import intersect_point_line

from ...bridge.changes.handles import handles_of
from ...bridge.objects.imported import drive_of, imported_objects
from ...bridge.objects.sensors import is_keyed
from ...bridge.sampling.stepping import frame_of
from ...core.geometry import FloatArray
from ...editing.layout.shapes import INNER, arrow, disc
from ...editing.motion.keys import HANDLE_LIMIT, Handle
from ...editing.sampled.clock import Clock
from .drag import TARGET_M, active_sensor, moving_actor, target_of
from .overlay import Grip, graph_place, grips

HANDLE, TARGET = 0.09, 0.11
"""Radii of round handles, as shares of Blender's gizmo size."""
HIT_PX = 8.0
"""Distance of the mouse within which a handle and the outer part of the arrow are hit, in pixels at resolution scale
1."""
BESIDE_S = 0.05
"""Times nearer than this to the frame that is shown are that frame's."""
LANE_COLOUR, KEY_COLOUR, SECOND_COLOUR, AIM_COLOUR = (0.2, 0.8, 0.3), (1.0, 0.8, 0.1), (0.9, 0.9, 0.9), (0.3, 0.75, 1.0)
LIT = (1.0, 1.0, 1.0)


def are_shown(context: bpy.types.Context) -> bool:
    """Return whether a 3D view shows gizmos of the drive."""
    scene, space = context.scene, context.space_data
    if not scene.unisim.log or not scene.unisim_motion.show_gizmos or context.mode != "OBJECT" or not space.show_gizmo:
        return False
    return bool(scene.unisim_motion.gizmos_in_cameras or not through(context, "CAMERA"))


def through(context: bpy.types.Context, *kinds: str) -> bool:
    """Return whether a view looks through a camera of some kinds."""
    camera, looks = context.scene.camera, context.space_data.region_3d
    return (
        looks is not None and looks.view_perspective == "CAMERA" and camera is not None and camera.unisim.kind in kinds
    )


class _Shape:
    """A shape that starts an operator. It has no motion of its own: its group puts it where the operator
    has moved objects."""

    def setup(self: Any) -> None:
        if not hasattr(self, "shape"):
            self.shape = self.new_custom_shape("TRIS", self.triangles())

    def reach(self: Any, context: bpy.types.Context) -> float:
        """Return how near the mouse has to be, in pixels."""
        return HIT_PX * float(context.preferences.system.ui_scale)


class UNISIM_GT_dot(_Shape, bpy.types.Gizmo):
    """A round handle that faces the view"""

    bl_idname = "UNISIM_GT_dot"
    __slots__ = ("shape",)

    def triangles(self) -> list[tuple[float, float, float]]:
        return disc()

    def draw(self, context: bpy.types.Context) -> None:
        world = self.matrix_world
        size = Matrix.Scale(world.median_scale, 4)
        turn = context.region_data.view_rotation.to_matrix().to_4x4()
        self.draw_custom_shape(self.shape, matrix=Matrix.Translation(world.translation) @ turn @ size)

    def test_select(self, context: bpy.types.Context, location: tuple[int, int]) -> int:
        at = location_3d_to_region_2d(context.region, context.region_data, self.matrix_world.translation)
        return 0 if at is not None and (at - Vector(location)).length <= self.reach(context) else -1


class UNISIM_GT_arrow(_Shape, bpy.types.Gizmo):
    """An arrow along its z axis"""

    bl_idname = "UNISIM_GT_arrow"
    __slots__ = ("shape",)

    def triangles(self) -> list[tuple[float, float, float]]:
        return arrow()

    def draw(self, context: bpy.types.Context) -> None:
        self.draw_custom_shape(self.shape)

    def test_select(self, context: bpy.types.Context, location: tuple[int, int]) -> int:
        """Return 0 where the mouse is on its outer part, else -1."""
        ends = [
            location_3d_to_region_2d(context.region, context.region_data, self.matrix_world @ Vector((0.0, 0.0, share)))
            for share in (INNER, 1.0)
        ]
        if ends[0] is None or ends[1] is None:
            return -1
        nearest, share = intersect_point_line(Vector(location), *ends)
        if not 0.0 <= share <= 1.0:
            nearest = ends[0] if share < 0 else ends[1]
        return 0 if (Vector(location) - nearest.to_2d()).length <= self.reach(context) else -1


class UNISIM_GT_speed(bpy.types.Gizmo):
    """The curve of the speed graph"""

    bl_idname = "UNISIM_GT_speed"

    def draw(self, context: bpy.types.Context) -> None:
        """Nothing: the graph is drawn with the overlays, and a dot on it where the mouse is."""
        if not self.is_highlight and grips.pop("hover", None) is not None:
            context.region.tag_redraw()

    def test_select(self, context: bpy.types.Context, location: tuple[int, int]) -> int:
        place = graph_place(context)
        near = HIT_PX * context.preferences.system.ui_scale
        time_s = place.time_at(*location, near) if place is not None else None
        if time_s is None:
            return -1
        grips["hover"] = Grip(time_s)
        context.region.tag_redraw()
        return 0


class GizmosInView:
    """Base of the groups of gizmos."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"3D", "PERSISTENT", "SHOW_MODAL_ALL"}


class Handles(GizmosInView):
    """Base of groups of round handles, each of which starts ``operator`` with properties of its own. There are ``most``
    of them; those that have no place are hidden."""

    operator: ClassVar[str]
    most: ClassVar[int] = 2
    size: ClassVar[float] = HANDLE
    colour: ClassVar[tuple[float, float, float]] = KEY_COLOUR

    def setup(self: Any, context: bpy.types.Context) -> None:
        self.handles = []
        for _ in range(self.most):
            handle = self.gizmos.new(UNISIM_GT_dot.bl_idname)
            handle.scale_basis = self.size
            painted(handle, self.colour)
            self.handles.append((handle, handle.target_set_operator(self.operator)))

    def places(self: Any, context: bpy.types.Context) -> Iterable[tuple[FloatArray, dict[str, Any]]]:
        """Return where handles are, each a place (3,) and what its operator is called with."""
        raise NotImplementedError

    def draw_prepare(self: Any, context: bpy.types.Context) -> None:
        places = list(self.places(context))
        for i, (handle, properties) in enumerate(self.handles):
            handle.hide = i >= len(places)
            if not handle.hide:
                place, given = places[i]
                handle.matrix_basis = Matrix.Translation(Vector(place))
                for name, value in given.items():
                    setattr(properties, name, value)


class UNISIM_GGT_lane(GizmosInView, bpy.types.GizmoGroup):
    """An arrow to the ego vehicle's left, which shifts its lane"""

    bl_label = "Ego Lane"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        seen = context.space_data.show_object_viewport_empty
        return are_shown(context) and seen and next(imported_objects(context.scene, "EGO"), None) is not None

    def setup(self, context: bpy.types.Context) -> None:
        self.arrow = self.gizmos.new(UNISIM_GT_arrow.bl_idname)
        self.arrow.target_set_operator("unisim.drag_ego")
        painted(self.arrow, LANE_COLOUR)

    def draw_prepare(self, context: bpy.types.Context) -> None:
        ego = next(imported_objects(context.scene, "EGO"), None)
        if ego is not None:
            world = ego.matrix_world
            self.arrow.matrix_basis = standing(world.translation, world.to_3x3().col[1])


class UNISIM_GGT_trajectory(Handles, bpy.types.GizmoGroup):
    """Handles on the active actor's trajectory, which displace it at their time"""

    bl_label = "Trajectory"
    operator = "unisim.drag_trajectory"
    most = 2 * HANDLE_LIMIT

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        met, _ = moving_actor(context)
        return bool(
            are_shown(context) and met and context.active_object.select_get() and context.scene.unisim.show_ways
        )

    def places(self, context: bpy.types.Context) -> Iterator[tuple[FloatArray, dict[str, Any]]]:
        """Yield the places of keys and of whole seconds, each in its colour."""
        for handle, (dot, _) in zip(shown_handles(context), self.handles, strict=False):
            painted(dot, KEY_COLOUR if handle.is_key else SECOND_COLOUR)
            yield handle.place, {"time_s": handle.time_s}


class UNISIM_GGT_speed(bpy.types.GizmoGroup):
    """The curve of the speed graph, which changes the active actor's speed"""

    bl_label = "Speed"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"PERSISTENT", "SCALE", "SHOW_MODAL_ALL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        shown = context.scene.unisim_motion.show_graph and context.space_data.show_gizmo
        return bool(shown and context.mode == "OBJECT" and moving_actor(context)[0])

    def setup(self, context: bpy.types.Context) -> None:
        self.curve = self.gizmos.new(UNISIM_GT_speed.bl_idname)
        self.curve.target_set_operator("unisim.drag_speed")
        self.curve.use_draw_modal = True


class UNISIM_GGT_aim(Handles, bpy.types.GizmoGroup):
    """A handle ahead of the active sensor, which turns its mount"""

    bl_label = "Sensor Direction"
    operator, most, size, colour = "unisim.drag_aim", 1, TARGET, AIM_COLOUR

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A sensor has to be active and selected that is not looked through, and whose rotation is free."""
        met, _ = active_sensor(context)
        if not (are_shown(context) and met and context.active_object.select_get()) or is_keyed(context.active_object):
            return False
        return not (through(context, "CAMERA") and context.scene.camera == context.active_object)

    def setup(self, context: bpy.types.Context) -> None:
        """Make a line to the handle, that takes no clicks, and the handle."""
        self.line = self.gizmos.new("GIZMO_GT_arrow_3d")
        self.line.draw_options, self.line.hide_select = {"STEM"}, True
        self.line.use_draw_scale = False
        self.line.length = TARGET_M
        painted(self.line, AIM_COLOUR)
        super().setup(context)

    def places(self, context: bpy.types.Context) -> Iterator[tuple[FloatArray, dict[str, Any]]]:
        obj = context.active_object
        if obj is not None and active_sensor(context)[0]:
            target, place = target_of(obj), obj.matrix_world.translation
            self.line.matrix_basis = standing(place, Vector(target) - place)
            yield target, {}


def shown_handles(context: bpy.types.Context) -> list[Handle]:
    """Return the handles of the active actor's trajectory.

    In the middle of the actor there is none without a key: a drag that begins there is meant for the actor.
    """
    obj, drive = context.active_object, drive_of(context.scene)
    if obj is None or drive is None:
        return []
    clock = Clock.of(drive)
    now = float(clock.time_s(np.array(frame_of(context.scene))))
    return [handle for handle in handles_of(obj, clock) if handle.is_key or abs(handle.time_s - now) > BESIDE_S]


def painted(gizmo: Any, colour: tuple[float, float, float]) -> None:
    """Give a gizmo its colours."""
    gizmo.color, gizmo.alpha = colour, 0.7
    gizmo.color_highlight, gizmo.alpha_highlight = LIT, 1.0
    gizmo.use_draw_modal = True


def standing(place: Vector, along: Vector) -> Matrix:
    """Return a matrix at a place whose z axis points along a direction."""
    turn = Vector(np.asarray(along, float)).to_track_quat("Z", "Y")
    return Matrix.LocRotScale(place, turn, None)


def draw_switches(self: bpy.types.Panel, context: bpy.types.Context) -> None:
    """Draw the switches in the popover Gizmos of the 3D view."""
    if context.scene.unisim.log:
        column = self.layout.column()
        column.active = context.space_data.show_gizmo
        column.label(text="UniSim")
        column.prop(context.scene.unisim_motion, "show_gizmos")
        below = column.column()
        below.active = context.scene.unisim_motion.show_gizmos
        below.prop(context.scene.unisim_motion, "gizmos_in_cameras")


MENUS = ((bpy.types.VIEW3D_PT_gizmo_display, draw_switches),)
