"""Actors with another appearance, and actors of trained scenes, chosen by their thumbnails."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import bpy
import numpy as np
from bpy.props import EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper
from mathutils import Quaternion, Vector

from ...bridge.changes.carriers.scale import give_box
from ...bridge.changes.maneuvers import best_seen
from ...bridge.changes.motion import move_along, retimed
from ...bridge.objects.animation import shown_by_keys
from ...bridge.objects.imported import add_actor, box_mesh, source_of, stand_at
from ...bridge.objects.meshes import size_of
from ...bridge.objects.trajectories import keyed_poses, span_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.views.actors import ego_poses, neighbours
from ...bridge.window import Need, choose, chosen, drive, object_mode, selected
from ...core.actor_images.names import group_of, readable_names
from ...core.errors import UnisimError
from ...core.model.scene_file import HEADER_NAME, read_scene_header
from ...core.world.drive import Actor
from ...editing.actors.table import class_and_size, named_actors, natural
from ...editing.motion.braking import habits_of
from ...editing.motion.kinematics import motion_of
from ...editing.motion.placement import heading_along, place_ahead
from ...editing.motion.plausibility import ground_height
from ...editing.motion.retiming import Retiming
from ...editing.sampled.clock import Clock, recorded_poses
from ...translations import interface, message
from ..actor_list.operators import GROUPS
from ..operator_bases import EditsObjects, Needing
from ..problems import draw_problem, fail
from . import thumbnails

PAGE = 32
"""Thumbnails in one grid: what fits the window."""
ICON_SCALE, GRID_SCALE = 8.0, 5.0
"""Edges of the chosen actor's thumbnail and of those in the grid, in widget units."""
ActorChoice = tuple[str, str, str, int, int]
NONE: list[ActorChoice] = [("", "None", "There is no such actor", 0, 0)]
_texts: dict[str, str] = {}
"""Every text that a menu has shown: Blender keeps where it lies, and not the text."""


@dataclass(frozen=True)
class ActorChoices:
    """The actors that can be chosen, by id: those of a trained scene in a folder, or of the drive itself
    where that is None."""

    actors: dict[str, Actor]
    names: dict[str, str]
    log_path: Path
    scene_path: Path | None


_headers: dict[Path, tuple[float, Any]] = {}
"""Headers of trained scenes, with the time of their last change."""


def choice_of(context: bpy.types.Context, folder: str) -> ActorChoices:
    """Return the actors of the trained scene in a folder, or of the imported drive where that is "".
    Raises `UnisimError`."""
    if not folder:
        source = source_of(context.scene)
        log_path, scene_path = thumbnails.log_of(context.scene), thumbnails.scene_of(context.scene)
        actors, counted = source.drive.actors, named_actors(source)
    else:
        scene_path = Path(bpy.path.abspath(folder))
        header = header_of(scene_path)
        log_path, actors = (scene_path / header.log_path).resolve(), header.drive.actors
        counted = actors
    thumbnails.ask(log_path)
    words = {uid: image.word for uid, image in thumbnails.images_of(log_path).items()}
    names = readable_names(counted, words)
    return ActorChoices(actors, {uid: names[uid] for uid in actors}, log_path, scene_path)


def header_of(scene_path: Path) -> Any:
    """Return a trained scene's header, read again only where it has changed."""
    changed = (scene_path / HEADER_NAME).stat().st_mtime
    if scene_path not in _headers or _headers[scene_path][0] != changed:
        _headers[scene_path] = changed, read_scene_header(scene_path)
    return _headers[scene_path][1]


def listed(choice: ActorChoices, group: str) -> list[str]:
    """Return the ids of the actors of a group, or of "ALL", in the order of their names."""
    uids = [uid for uid, actor in choice.actors.items() if group in ("ALL", group_of(actor.label))]
    return sorted(uids, key=lambda uid: natural(choice.names[uid]))


def items_of(context: bpy.types.Context, folder: str, group: str, page: int) -> list[ActorChoice]:
    """Return the actors of a group for a menu with thumbnails; ``page`` 1, 2, … has `PAGE` of them, 0 has all."""
    try:
        choice = choice_of(context, folder)
    except (UnisimError, OSError):
        return NONE
    numbers = {uid: number + 1 for number, uid in enumerate(sorted(choice.actors))}
    uids = listed(choice, group)
    uids = uids[(page - 1) * PAGE : page * PAGE] if page else uids
    return [
        (
            lasting(uid),
            lasting(choice.names[uid]),
            lasting(class_and_size(choice.actors[uid])),
            thumbnails.icon_of(choice.log_path, uid, choice.scene_path),
            numbers[uid],
        )
        for uid in uids
    ] or NONE


def lasting(text: str) -> str:
    """Return the same text as an object that stays."""
    return _texts.setdefault(text, text)


def pages(context: bpy.types.Context, folder: str, group: str) -> int:
    """Return how many grids the actors of a group take."""
    try:
        return max(1, -(-len(listed(choice_of(context, folder), group)) // PAGE))
    except (UnisimError, OSError):
        return 1


def draw_choice(layout: bpy.types.UILayout, context: bpy.types.Context, operator: Any, folder: str) -> None:
    """Draw class, page, the chosen actor's thumbnail, which opens the grid of all, and what it is."""
    row = layout.row(align=True)
    row.prop(operator, "group", text="")
    count = pages(context, folder, operator.group)
    part = row.row(align=True)
    part.enabled = count > 1
    part.prop(operator, "page", text=interface("Page (of {count})", count=count), translate=False)
    layout.template_icon_view(operator, "appearance", show_labels=True, scale=ICON_SCALE, scale_popup=GRID_SCALE)
    try:
        choice = choice_of(context, folder)
    except (UnisimError, OSError) as fault:
        draw_problem(layout, str(fault), "ERROR")
        return
    known = operator.appearance in choice.actors
    layout.label(text=choice.names[operator.appearance] if known else "Click the image to choose")
    layout.label(text=class_and_size(choice.actors[operator.appearance]) if known else "")


WIDTH_PX = 320


def folder_of(filepath: str) -> str:
    """Return the folder of a trained scene, of its scene.json or itself; "" of ""."""
    if not filepath:
        return ""
    path = Path(bpy.path.abspath(filepath))
    return str(path.parent if path.name == HEADER_NAME else path)


def chosen_folder(self: bpy.types.OperatorProperties) -> str:
    """Return the folder of the trained scene whose actors are chosen from; "" for the drive's own."""
    return folder_of(self.filepath) if hasattr(self, "filepath") else str(self.scene)


def appearances(self: bpy.types.OperatorProperties, context: bpy.types.Context) -> list[ActorChoice]:
    """Return the actors of the menu."""
    return items_of(context, chosen_folder(self), self.group, self.page)


def other_page(self: bpy.types.OperatorProperties, context: bpy.types.Context) -> None:
    """Another class or page is shown: its first actor is chosen."""
    folder = chosen_folder(self)
    last = pages(context, folder, self.group)
    if self.page > last:
        self.page = last
        return  # which comes here again
    first, *_ = items_of(context, folder, self.group, self.page)[0]
    if first:  # there is one
        self.appearance = first


class _Chooses(EditsObjects):
    """Base of operators that choose an actor by its thumbnail: ``confirm`` is the text of their button, ``first_group``
    the class that is shown where no actor is active."""

    confirm: ClassVar[str]
    first_group: ClassVar[str] = "ALL"
    group: EnumProperty(name="Class", description="Classes that are shown", items=GROUPS, update=other_page)
    page: IntProperty(name="Page", description="Page that is shown", min=0, soft_min=1, update=other_page)

    def invoke(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask which, of the active actor's class first."""
        actors, obj = chosen(context, "ACTOR"), context.active_object
        if obj is None or obj.unisim.kind != "ACTOR" or (actors and obj not in actors):
            obj = next(iter(actors), None)
        uid = obj.unisim.look or obj.unisim.uid if obj is not None else ""
        try:
            actor = choice_of(context, chosen_folder(self)).actors.get(uid)
        except (UnisimError, OSError) as fault:
            return fail(self, fault)
        self.begin(context, group_of(actor.label) if actor is not None else self.first_group, uid)
        return context.window_manager.invoke_props_dialog(self, width=WIDTH_PX, confirm_text=self.confirm)

    def begin(self: Any, context: bpy.types.Context, group: str, uid: str) -> None:
        """Show the actors of a group, and one of them, if it is there."""
        folder, self.group = chosen_folder(self), group
        try:
            uids = listed(choice_of(context, folder), self.group)
            if not uids:
                self.group, uids = "ALL", listed(choice_of(context, folder), "ALL")
        except (UnisimError, OSError):
            return
        at, count = uids.index(uid) if uid in uids else 0, pages(context, folder, self.group)
        self.page = 1 + at * count // max(len(uids), 1) if count > 1 else 1
        items = [item[0] for item in items_of(context, folder, self.group, self.page)]
        self.appearance = uid if uid in items else items[0]

    def draw(self: Any, context: bpy.types.Context) -> None:
        draw_choice(self.layout, context, self, chosen_folder(self))


def no_mesh(context: bpy.types.Context) -> Need:
    """No mesh actor is selected."""
    plain = not any(obj.unisim.mesh for obj in chosen(context, "ACTOR"))
    return plain, "Mesh actors keep their own appearance: select recorded actors only"


def trained(context: bpy.types.Context) -> Need:
    """The drive has a trained scene: without one, actors of other scenes are not shown."""
    return bool(context.scene.unisim.scene), "Import or train a trained scene first"


class UNISIM_OT_replace_appearance(_Chooses, bpy.types.Operator):
    """Replace the appearance and the box of the selected actors by those of another actor, on the same trajectory"""

    bl_label = "Replace Appearance"
    confirm = "Replace"
    needs = (object_mode, selected("Select an actor first", "ACTOR"), no_mesh)

    scene: StringProperty(
        name="Trained scene",
        description="Folder of the trained scene; empty for the one of the drive",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )
    appearance: EnumProperty(name="Appearance", description="Actor whose appearance is used", items=appearances)

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        actors = choice_of(context, self.scene).actors
        actor = actors.get(self.appearance) if self.properties.is_property_set("appearance") else None
        if actor is None:
            raise UnisimError(message("choose an actor by its thumbnail first"))
        for obj in chosen(context, "ACTOR"):
            give_look(obj, self.appearance, actor, self.scene)
        return chosen(context, "ACTOR")


def give_look(obj: bpy.types.Object, uid: str, actor: Actor, folder: str) -> None:
    """Give an object appearance and box of an actor, of the trained scene in a folder or of the drive, its underside
    where it was."""
    own = obj.unisim.uid == uid and not folder
    obj.unisim.look, obj.unisim.look_scene = ("", "") if own else (uid, folder)
    give_box(obj, box_mesh(actor.size_m, actor.label), float(actor.size_m[2]))


SLOW_GROUPS = ("PERSON", "CYCLE")
"""Classes that a vehicle's speed is too much for."""


class UNISIM_OT_swap_class(EditsObjects, bpy.types.Operator):
    """Replace the selected actors by those of a class that are most like them in size, on their paths, at its speeds"""

    bl_label = "Swap Class"
    needs = (object_mode, selected("Select an actor first", "ACTOR"), no_mesh)

    group: EnumProperty(name="Class", description="Class of the new actor", items=GROUPS[1:])
    scene: StringProperty(
        name="Trained scene",
        description="Folder of the trained scene; empty for the one of the drive",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """Other boxes; who goes faster than that class does is slowed down from the start on."""
        choice, clock = choice_of(context, self.scene), Clock.of(source_of(context.scene).drive)
        uids = listed(choice, self.group)
        if not uids:
            title = interface(next(name for key, name, *_ in GROUPS if key == self.group))
            raise UnisimError(
                message("there are no {group} here: insert one of another trained scene instead", group=title)
            )
        for obj in chosen(context, "ACTOR"):
            size_m = size_of(obj)
            apart = {uid: float(np.linalg.norm(choice.actors[uid].size_m - size_m)) for uid in uids}
            uid = min(uids, key=lambda uid: apart[uid])
            if self.group in SLOW_GROUPS and not self.scene:  # none is as large as a vehicle
                uid = best_seen(source_of(context.scene).drive, uids)
            give_look(obj, uid, choice.actors[uid], self.scene)
            if self.group in SLOW_GROUPS:
                slow_down(obj, habits_of(choice.actors[uid].label).speed_m_s, clock)
        return chosen(context, "ACTOR")


def slow_down(obj: bpy.types.Object, speed_m_s: float, clock: Clock) -> None:
    """Let an actor go at most so fast, as much slower throughout."""
    there, span = shown_by_keys(obj, clock.frames), span_of(obj)
    if span is None or not there.any():
        return
    fastest = np.nanmax(motion_of(keyed_poses(obj, clock.frames)[:, :3, 3], clock.times_s, there).speed_m_s)
    if fastest > speed_m_s:
        start_s = float(clock.time_s(np.array(span[0])))
        retimed(obj, Retiming("SPEED", 0.0, speed_m_s / float(fastest), start_s, 0.0).frames(clock))


PLACES = (
    (
        "AHEAD",
        "In front of the ego",
        "On the ego vehicle's path or the nearest one, at its speed, clear of other actors",
    ),
    (
        "CURSOR",
        "At the 3D cursor",
        "At the 3D cursor, standing along the nearest recorded path, or as the cursor is turned about the vertical",
    ),
)
UP = Vector((0.0, 0.0, 1.0))
TURNED_RAD = 1e-3
"""From this angle on the 3D cursor was turned, or is not upright."""


def put_ahead(scene: bpy.types.Scene, obj: bpy.types.Object, actor: Actor) -> None:
    """Put a new object for an actor in front of the ego vehicle at the current frame."""
    source = source_of(scene)
    drive, clock = source.drive, Clock.of(source.drive)
    at = int(np.abs(clock.frames - frame_of(scene)).argmin())
    ego, others = ego_poses(scene, drive, clock), neighbours(scene, [obj], drive, clock)
    size_m = actor.appearance_size_m
    place = place_ahead(actor.label, size_m, ego, others, at, clock.times_s)
    ground_m = None if place.height_m else ground_height(source, place.road, int(clock.frames[at]))
    poses = place.on_ground(ground_m, float(size_m[2]))
    if place.stands:
        stand_at(obj, poses[at])
    else:
        move_along(obj, poses, clock)


def cursor_rotation(scene: bpy.types.Scene) -> Quaternion:
    """Return the 3D cursor's rotation where it was turned about the vertical, else the direction of the nearest recorded path
    there: a click that sets the cursor leaves it turned as the view."""
    turned = scene.cursor.matrix.to_quaternion()
    if turned.angle > TURNED_RAD and (turned @ UP).angle(UP) < TURNED_RAD:
        return turned
    drive = source_of(scene).drive
    clock = Clock.of(drive)
    paths = [drive.world_from_ego.at(clock.times_s), *(recorded_poses(actor, clock) for actor in drive.actors.values())]
    return Quaternion(UP, heading_along(np.array(scene.cursor.location), paths))


class UNISIM_OT_insert_actor(_Chooses, bpy.types.Operator):
    """Insert an actor of the drive or of a trained scene in front of the ego vehicle, or at the 3D cursor"""

    bl_label = "Insert Actor"
    confirm, first_group = "Insert", "CAR"
    needs = (object_mode, drive)

    filepath: StringProperty(
        name="Trained scene", description="Folder or scene.json of the trained scene; empty for the drive",
        subtype="FILE_PATH",
        options={"HIDDEN", "SKIP_SAVE"},
    )  # fmt: skip
    actor: StringProperty(
        name="Actor",
        description="Identifier in the trained scene; empty for the one chosen by its thumbnail",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    appearance: EnumProperty(name="Actor", description="Actor to insert", items=appearances)
    where: EnumProperty(name="Where", description="Location of the actor", items=PLACES)

    def draw(self, context: bpy.types.Context) -> None:
        super().draw(context)
        self.layout.prop(self, "where", text="")

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        folder = chosen_folder(self)
        choice = choice_of(context, folder)
        vehicles = listed(choice, "CAR") or listed(choice, "ALL")
        uid = self.actor or (
            self.appearance if self.properties.is_property_set("appearance") else next(iter(vehicles), "")
        )
        if uid not in choice.actors:
            raise UnisimError(message('{folder}: has no actor "{name}"', folder=folder or choice.log_path, name=uid))
        actor = choice.actors[uid]
        obj = add_actor(context.scene, choice.names[uid], actor, uid, folder)
        if self.where == "CURSOR":
            obj.location = np.array(context.scene.cursor.location) + [0.0, 0.0, actor.size_m[2] / 2]
            obj.rotation_quaternion = cursor_rotation(context.scene)
        else:
            put_ahead(context.scene, obj, actor)
        choose(context, obj)
        return [obj]


class UNISIM_OT_insert_from(Needing, bpy.types.Operator, ImportHelper):
    """Choose another trained scene, and insert one of its actors"""

    bl_label = "Insert from Another Scene"
    bl_options = {"INTERNAL"}
    needs = (object_mode, drive, trained)

    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            answer = bpy.ops.unisim.insert_actor("INVOKE_DEFAULT", filepath=self.filepath)
        except RuntimeError as fault:  # what the operator reports
            return fail(self, UnisimError(str(fault).removeprefix("Error: ").strip()))
        return {"FINISHED"} if answer != {"CANCELLED"} else answer
