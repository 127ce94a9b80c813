"""Rows of cones and of parked cars beside a path, with handles at both ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatVectorProperty, IntProperty, StringProperty

from ...bridge.changes.rows import Boxes, arranged, copies, members
from ...bridge.objects.imported import as_imported, class_of, imported_objects, source_of
from ...bridge.objects.meshes import size_of
from ...bridge.objects.trajectories import trajectory_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.views.actors import neighbours
from ...bridge.window import Need, choose, drive, object_mode
from ...core.actor_images.names import group_of
from ...core.errors import UnisimError
from ...core.geometry import FloatArray
from ...core.scenario.edits.row import EGO, Row, clear, standing
from ...core.scenario.motion.maneuvers import DrivenPath
from ...core.world.drive import Drive
from ...editing.edits.lines import metres
from ...editing.motion.keys import stepped
from ...editing.readers.actors import row_of
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import rigid
from ...editing.texts import Text, free_name, series
from ...translations import localized, message
from ..operator_bases import EditsObjects, Needing, draw_split, in_metres
from .drag import STEP_M, Dragged
from .gizmos import HANDLE, Handles, are_shown
from .operators import curve_line

PATHS = (
    ("EGO", "Ego Vehicle", "Along the recorded path of the ego vehicle"),
    ("ACTOR", "Actor", "Along the recorded path of the actor that drives nearest to the row's source"),
    ("CURVE", "Curve", "Along the selected curve"),
    ("OWN", "Straight", "Along the axis of the row's source"),
)
AHEAD_M, CONES_M, CONES = 8.0, 24.0, 6
"""From the ego vehicle to the first cone, the length of a row of cones, and their number."""
LANE_EDGE_M = -1.9
FARTHEST, FAR = 16, 0.25
"""Number of places by which a row is moved at most to where its places are free; how many free ones outweigh one."""
NUMBERS = ("along", "start_m", "end_m", "by_spacing", "count", "spacing_m", "left_m", "end_left_m", "variation_m")
"""Properties of operators that put rows."""
PARKED, PARKED_GAP_M, PARKED_VARIATION_M = 4, 1.2, 0.25
"""Number of parked cars in a row, the gaps between them, and by how much they vary."""
BESIDE_M, PARALLEL = 12.0, 0.9
"""How far from the ego's path, and how parallel to it (a cosine), a car stands that is parked along it."""


def along_of(obj: bpy.types.Object, recorded: Drive) -> DrivenPath | None:
    """Return the ego's path where an object stands beside it and along it."""
    course, pose = DrivenPath.of(recorded.world_from_ego), rigid(np.array(obj.matrix_world, float))
    if course is None:
        return None
    gone, left, _ = course.nearest(pose[:3, 3])
    heading = float(course.beside(np.array([gone]))[1][0])
    parallel = abs(np.cos(heading) * pose[0, 0] + np.sin(heading) * pose[1, 0])
    return course if abs(left) < BESIDE_M and parallel > PARALLEL else None


def curve_points(context: bpy.types.Context) -> tuple[tuple[float, float, float], ...]:
    """Return the points of the selected curve. Raises `UnisimError`."""
    curve = next((obj for obj in context.selected_objects if obj.type == "CURVE"), None)
    if curve is None:
        raise UnisimError(message("select a curve in addition (Add > Curve)"))
    return tuple((x, y, z) for x, y, z in curve_line(context, curve).round(4).tolist())


class PlacesRow(EditsObjects):
    """Base of operators that put copies of what stands into a row."""

    needs = (object_mode, drive)
    back = 0
    """Number of places by which the row may begin earlier than at first."""

    along: EnumProperty(name="Along", description="Path that the row follows", items=PATHS, options={"SKIP_SAVE"})
    start_m: in_metres("From", "Along the path")
    end_m: in_metres("To", "Along the path")
    by_spacing: BoolProperty(
        name="By Spacing", description="State the spacing and not the number", options={"SKIP_SAVE"}
    )
    count: IntProperty(name="Number", description="Number of places", min=1, max=1000, options={"SKIP_SAVE"})
    spacing_m: in_metres("Spacing", "From one to the next", 4.0, min=0.1)
    left_m: in_metres("Sideways", "To the left of the path; negative: to the right")
    end_left_m: in_metres("Sideways at the End", "The row goes over to this distance")
    variation_m: in_metres(
        "Variation", "By how much each stands elsewhere along the row; it is also a little aside and turned", min=0.0
    )
    source: StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    id: StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    def draw(self: Any, context: bpy.types.Context) -> None:
        """Draw the numbers, but for the spacing or the number that follows from the other."""
        draw_split(self, *(name for name in NUMBERS if name != ("count" if self.by_spacing else "spacing_m")))

    def found(self: Any, context: bpy.types.Context, recorded: Drive) -> bpy.types.Object | None:
        """Return what is copied; None where nothing fits."""
        raise NotImplementedError

    def begin(self: Any, context: bpy.types.Context, obj: bpy.types.Object, recorded: Drive) -> dict[str, Any]:
        """Return the numbers that the row has at first."""
        raise NotImplementedError

    def slide(self: Any, row: Row, obj: bpy.types.Object, recorded: Drive, others: Boxes) -> None:
        """Move the row along its path, a place at a time, to where most of its places are free, and near."""
        count, before = self.count, self.back
        step = (self.end_m - self.start_m) / max(count - 1, 1)
        longer = replace(
            row, start_m=row.start_m - before * step, end_m=row.start_m + (FARTHEST + count - 1) * step,
            count=before + FARTHEST + count, spacing_m=None,
        )  # fmt: skip
        size_m = np.array(size_of(obj))
        poses = longer.poses(rigid(np.array(obj.matrix_world, float)), size_m, recorded, row.id)
        free = np.convolve(clear(poses, size_m, others), np.ones(count), "valid")
        best = int((free - FAR * np.abs(np.arange(len(free)) - before + 0.1)).argmax())
        self.start_m, self.end_m = (float(end + (best - before) * step) for end in (self.start_m, self.end_m))

    def edit(self: Any, context: bpy.types.Context) -> list[bpy.types.Object] | set[str]:
        """Put the row there and select it; numbers that are not given are those of `begin`."""
        scene, recorded = context.scene, source_of(context.scene).drive
        obj = scene.objects.get(self.source) or self.found(context, recorded)
        if obj is None:
            return self.without(context)
        given = set(NUMBERS)
        if not self.source:
            ids = {other.name.rpartition(" ")[0] for other in bpy.data.objects}
            self.source, self.id = obj.name, free_name(self.bl_label, ids)
            given = {name for name in NUMBERS if self.properties.is_property_set(name)}
            for name, value in self.begin(context, obj, recorded).items():
                if name not in given:
                    setattr(self, name, value)
        row = self.row(context, obj, recorded)
        others = boxes(scene, recorded, row)
        if not given & {"start_m", "end_m"}:
            self.slide(row, obj, recorded, others)
            row = self.row(context, obj, recorded)
        is_recorded = obj == as_imported(scene, "ACTOR", obj.unisim.uid) and obj.unisim.uid in recorded.actors
        placed = arranged(scene, row, recorded, others) if is_recorded else copies(context, obj, row, recorded, others)
        if not placed:
            raise UnisimError(message("something else stands at all places"))
        choose(context, *placed)
        self.report({"INFO"}, localized(row_words(row, len(placed))))
        return placed

    def row(self: Any, context: bpy.types.Context, obj: bpy.types.Object, recorded: Drive) -> Row:
        """Return the row as it is set."""
        metres_of = {name: round(getattr(self, name), 3) for name in NUMBERS if name.endswith("_m")}
        if not self.by_spacing:
            metres_of["spacing_m"] = None
        along = nearest_driver(obj, recorded) if self.along == "ACTOR" else EGO if self.along == "EGO" else None
        path = curve_points(context) if self.along == "CURVE" else None
        count = None if self.by_spacing else self.count
        return Row(obj.unisim.uid, self.id, **metres_of, count=count, along=along, path=path)

    def without(self: Any, context: bpy.types.Context) -> set[str]:
        raise UnisimError(message("select a car or another actor that stands"))


def nearest_driver(obj: bpy.types.Object, recorded: Drive) -> str:
    """Return the id of the actor whose path passes an object nearest. Raises `UnisimError` where none drives."""
    place = np.array(obj.matrix_world.translation, float)
    away = {
        uid: float(np.linalg.norm(actor.world_from_actor.positions - place, axis=1).min())
        for uid, actor in recorded.actors.items()
        if DrivenPath.of(actor.world_from_actor) is not None
    }
    if not away:
        raise UnisimError(message("no actor drives"))
    return min(away, key=lambda uid: away[uid])


def boxes(scene: bpy.types.Scene, recorded: Drive, row: Row) -> Boxes:
    """Return what a row keeps clear of: all actors that are not in it."""
    own = members(scene, row)
    them = neighbours(scene, own, recorded, Clock.of(recorded))
    return [(other.poses[other.there], other.size_m) for other in them if other.there.any()]


def row_words(row: Row, count: int) -> Text:
    """Return how many stand in a row, and from where to where."""
    span = Text("{length} long", length=metres(abs(row.end_m - row.start_m)))
    places = Text("{count} of {total} places", count=count, total=row.count or count)
    return series([row.id, series([places, span])], ": ")


class UNISIM_OT_row_of_cones(PlacesRow, bpy.types.Operator):
    """Put cones, copies of one of the drive or of the selected item, in a row beside the ego vehicle's path or a curve"""

    bl_label = "Row of Cones"

    def found(self, context: bpy.types.Context, recorded: Drive) -> bpy.types.Object | None:
        """Return the selected static item, mesh or cone, else a cone of the drive."""
        obj = context.active_object
        if obj is not None and obj.select_get() and (obj.unisim.kind == "STATIC" or is_cone(obj, recorded)):
            return obj
        cones = (each for each in imported_objects(context.scene, "ACTOR") if is_cone(each, recorded))
        return next(cones, None) or next(imported_objects(context.scene, "STATIC"), None)

    def begin(self, context: bpy.types.Context, obj: bpy.types.Object, recorded: Drive) -> dict[str, Any]:
        """Return the numbers of a row at the right edge of the ego's lane, ahead of it."""
        numbers = {"count": CONES, "left_m": LANE_EDGE_M, "end_left_m": LANE_EDGE_M}
        if any(each.type == "CURVE" for each in context.selected_objects):
            points = np.array(curve_points(context))
            length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            return {**numbers, "along": "CURVE", "end_m": length, "left_m": 0.0, "end_left_m": 0.0}
        course, clock = DrivenPath.of(recorded.world_from_ego), Clock.of(recorded)
        if course is None:
            return {**numbers, "along": "OWN", "left_m": 0.0, "end_left_m": 0.0, "start_m": 2.0, "end_m": 2.0 + CONES_M}
        start_m = float(course.gone(float(clock.time_s(np.array(frame_of(context.scene)))))) + AHEAD_M
        return {**numbers, "along": "EGO", "start_m": start_m, "end_m": start_m + CONES_M}

    def without(self, context: bpy.types.Context) -> set[str]:
        """Say how a cone gets there, with buttons."""

        def draw(self: Any, context: bpy.types.Context) -> None:
            self.layout.operator_context = "INVOKE_DEFAULT"
            for name in ("unisim.mark_static", "unisim.mesh_actor", "unisim.insert_from"):
                self.layout.operator(name)

        title = message("This drive has no cone: mark one that it shows, use a mesh, or insert one of a scene")
        if not bpy.app.background:
            context.window_manager.popup_menu(draw, title=title, icon="INFO")
        self.report({"WARNING"}, title)
        return {"CANCELLED"}


def is_cone(obj: bpy.types.Object, recorded: Drive) -> bool:
    """Return whether an actor is a cone."""
    return obj.unisim.kind == "ACTOR" and "cone" in class_of(obj, recorded).lower()


class UNISIM_OT_parked_row(PlacesRow, bpy.types.Operator):
    """Put copies of the selected car that stands in a row along the kerb, a little different from each other"""

    bl_label = "Parked Row"
    back = FARTHEST

    def found(self, context: bpy.types.Context, recorded: Drive) -> bpy.types.Object | None:
        """Return the active actor, if it stands."""
        obj = context.active_object
        stands = obj is not None and obj.unisim.kind == "ACTOR" and obj.select_get() and trajectory_of(obj) is None
        return obj if stands else None

    def begin(self, context: bpy.types.Context, obj: bpy.types.Object, recorded: Drive) -> dict[str, Any]:
        """Return the numbers of a row from it on."""
        course, length = along_of(obj, recorded), float(size_of(obj)[0])
        gone, left, _ = (0.0, 0.0, 0.0) if course is None else course.nearest(np.array(obj.matrix_world.translation))
        spacing = length + PARKED_GAP_M
        return {
            "along": "OWN" if course is None else "EGO", "by_spacing": True, "count": PARKED, "spacing_m": spacing,
            "start_m": gone + spacing, "end_m": gone + PARKED * spacing, "left_m": left, "end_left_m": left,
            "variation_m": PARKED_VARIATION_M if group_of(class_of(obj, recorded)) in ("CAR", "TRUCK") else 0.0,
        }  # fmt: skip


def in_row(context: bpy.types.Context) -> Need:
    """What stands in a row is active."""
    obj = context.active_object
    return obj is not None and obj.unisim.row, "Make an actor active that stands in a row"


class UNISIM_OT_drag_row(Needing, Dragged, bpy.types.Operator):
    """Drag the end of the active actor's row along its path and aside"""

    bl_label = "Change Row"
    needs = (object_mode, in_row)

    is_end: BoolProperty(name="End", description="The end and not the start", options={"SKIP_SAVE"})
    at_m: FloatVectorProperty(
        name="At", description="Along the path, and to its left", size=2, unit="LENGTH", options={"SKIP_SAVE"}
    )

    def subjects(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """Return none: the row is arranged again."""
        return []

    def note(self, context: bpy.types.Context) -> None:
        """Note the row, its path, and what it keeps clear of."""
        self.before = self.now = stated(context)
        self.drive = source_of(context.scene).drive
        self.course = self.before.course(standing(self.drive.actors[self.before.actor]), self.drive, "row")
        self.others = boxes(context.scene, self.drive, self.before)
        self.origin = ends(context)[self.is_end]

    def follow(self, context: bpy.types.Context, pressed: FloatArray, mouse: FloatArray, in_steps: bool) -> None:
        moved = self.dragged(context, pressed, mouse)
        if moved is not None:
            gone, left, _ = self.course.nearest(self.origin + moved)
            self.at_m = [stepped(gone, STEP_M, in_steps), stepped(left, STEP_M, in_steps)]

    def apply(self, context: bpy.types.Context) -> None:
        gone, left = (round(value, 3) for value in self.at_m)
        row = self.before
        end_left_m = row.left_m if row.end_left_m is None else row.end_left_m
        changed = {"end_m": gone, "end_left_m": left} if self.is_end else {"start_m": gone, "left_m": left}
        self.arrange(context, replace(row, **{"end_left_m": end_left_m, **changed}))

    def arrange(self, context: bpy.types.Context, row: Row) -> None:
        """Let the row's objects stand as a row says; its end or start stays active."""
        if row.end_m - row.start_m > 0.0:
            self.now = row
            placed = arranged(context.scene, row, self.drive, self.others)
            context.view_layer.update()  # what was deleted is no longer selected
            if placed:
                choose(context, *placed)

    def restore(self) -> None:
        """Nothing is put back between two places of the mouse."""

    def put_back(self, context: bpy.types.Context) -> set[str]:
        if self.moved:
            self.arrange(context, self.before)
        self.let_go(context)
        return {"CANCELLED"}

    def said(self, context: bpy.types.Context) -> str:
        return row_words(self.now, len(members(context.scene, self.now)))


def stated(context: bpy.types.Context) -> Row:
    """Return the row of the active actor."""
    row = row_of(context.active_object.unisim.row)
    assert row is not None  # the poll says so
    return row


def ends(context: bpy.types.Context) -> tuple[FloatArray, FloatArray]:
    """Return the places (3,) of the start and the end of the active actor's row."""
    row, recorded = stated(context), source_of(context.scene).drive
    course = row.course(standing(recorded.actors[row.actor]), recorded, "row")
    lefts = np.array([row.left_m or 0.0, (row.left_m or 0.0) if row.end_left_m is None else row.end_left_m])
    start, end = course.beside(np.array([row.start_m, row.end_m]), lefts)[0]
    return start, end


class UNISIM_GGT_row(Handles, bpy.types.GizmoGroup):
    """Handles at both ends of the active actor's row"""

    bl_label = "Row"
    operator, size = "unisim.drag_row", 1.5 * HANDLE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(are_shown(context) and in_row(context)[0] and context.active_object.select_get())

    def places(self, context: bpy.types.Context) -> Iterator[tuple[FloatArray, dict[str, Any]]]:
        if in_row(context)[0]:
            yield from ((place, {"is_end": bool(is_end)}) for is_end, place in enumerate(ends(context)))
