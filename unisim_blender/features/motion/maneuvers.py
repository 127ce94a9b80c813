"""Maneuvers in a few clicks: an operator that finds free room for its first numbers, and whose numbers F9 changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ...bridge.changes.maneuvers import Maneuvering, OtherActors, best_seen, inserted_at, scenario_id
from ...bridge.objects.imported import class_of, copy_of, drive_of, imported_objects, source_of
from ...bridge.objects.meshes import size_of
from ...bridge.objects.trajectories import keyed_pose
from ...bridge.views.actors import ego_poses, neighbours
from ...bridge.window import choose, chosen, drive, object_mode, selected
from ...core.actor_images.names import group_of
from ...core.errors import UnisimError
from ...core.geometry import FloatArray
from ...core.scenario.motion.maneuvers import FRONT_M
from ...core.simulation.vehicle.parameters import Vehicle
from ...editing.edits.maneuvers import ManeuverNote
from ...editing.motion.braking import habits_of
from ...editing.motion.keys import stepped
from ...editing.motion.placement import taken_by
from ...editing.readers.maneuvers import maneuver_words
from ...editing.sampled.clock import Clock
from ...editing.texts import Text, series
from ...translations import localized, message
from ..actors.appearances import choice_of, listed
from ..operator_bases import EditsObjects, Needing, draw_split, in_m_s, in_m_s2, in_metres, in_seconds
from .drag import Dragged
from .gizmos import Handles, are_shown
from .operators import FromTime


class ManeuverKind(NamedTuple):
    """A maneuver: its title, what it does, its icon, the classes of those that do it (none: any actor, which has to be
    there), and the operator's settings for it."""

    title: str
    about: str
    icon: str
    groups: tuple[str, ...]
    settings: tuple[str, ...]


KINDS = {
    "CUT_IN": ManeuverKind(
        "Cut-In", "Change into the lane of the ego vehicle in front of it", "LOOP_FORWARDS", ("CAR", "TRUCK"),
        ("who", "first_s", "side", "gap_by", "gap_s", "gap_m", "timed", "duration_s"),
    ),
    "CROSS": ManeuverKind(
        "Crossing", "A pedestrian or cyclist crosses the path of the ego vehicle in front of it", "ARMATURE_DATA",
        ("PERSON", "CYCLE"), ("who", "first_s", "side", "gap_by", "gap_s", "gap_m", "speed_m_s", "from_m"),
    ),
    "LANE_CHANGE": ManeuverKind(
        "Lane Change", "Change to the lane beside", "ARROW_LEFTRIGHT", (), ("first_s", "left_m", "timed", "duration_s")
    ),
    "BRAKE": ManeuverKind(
        "Brake", "Brake from a time on", "PAUSE", (), ("first_s", "deceleration_m_s2", "speed_m_s")
    ),
    "PLATOON": ManeuverKind(
        "Platoon", "Copies that follow the actor", "CON_FOLLOWPATH", (), ("count", "gap_s", "gap_m")
    ),
}  # fmt: skip
SIDES = (
    ("OWN", "From where it drives", "From where the actor drives, which has to be beside the ego vehicle's path"),
    ("LEFT", "From the left", "From the lane or the roadside to the left of the ego vehicle"),
    ("RIGHT", "From the right", "From the lane or the roadside to the right of the ego vehicle"),
)
WHO = (
    ("SELECTED", "The selected actor", "The active actor does it"),
    ("NEW", "A new actor", "An actor like one of this drive is inserted for it"),
)
GAPS = (("TIME", "In time", "The gap is a time"), ("LENGTH", "As a length", "The gap is a length"))
LEAD_S = 3.0
"""Time from the current frame until a crossing actor is on the ego vehicle's path, at first."""
BESIDE_M = 0.4
"""Room between a crossing actor and the ego vehicle when that passes as recorded, at first."""
FIRST: dict[str, list[Any]] = {
    "CUT_IN": [{"gap_by": "TIME", "gap_s": gap} for gap in (1.5, 1.0, 2.0, 2.5, 0.7)],
    "LANE_CHANGE": [{"left_m": left} for left in (3.5, -3.5, 3.0, -3.0)],
    "PERSON": [(6.0, 1.0), (3.0, 1.0), (6.0, 1.4), (6.0, 1.8), (6.0, 2.2), (3.0, 1.6)],
    "CYCLE": [(10.0, 1.0), (12.0, 1.0), (10.0, 1.5), (15.0, 1.0)],
}
"""Numbers that are tried, in this order. Of a crossing: from how far aside, and by how much more than the least gap that
is free of the ego vehicle, so that there is a way between parked cars."""
PLATOON = {"gap_s": 1.2, "gap_m": 2.0}
GROUND_M = 10.0
"""How far ahead of the ego vehicle the ground's height is taken for a new actor."""


def traffic_of(obj: bpy.types.Object) -> OtherActors:
    """Return the ego vehicle and the other actors beside an actor."""
    scene = bpy.context.scene
    recorded = source_of(scene).drive
    clock = Clock.of(recorded)
    others = [other.name for other in imported_objects(scene, "ACTOR") if other != obj and not other.hide_render]
    taken = taken_by(ego_poses(scene, recorded, clock), neighbours(scene, [obj], recorded, clock))
    return OtherActors(["Ego vehicle", *others], *taken)


class UNISIM_OT_maneuver(FromTime, EditsObjects, bpy.types.Operator):
    """Let the active actor, or a new one, do a maneuver; numbers can be changed afterwards (F9)"""

    bl_label = "Maneuver"
    needs = (object_mode, drive)

    kind: EnumProperty(
        name="Maneuver", description="What the actor does",
        items=[(name, kind.title, kind.about, kind.icon, i) for i, (name, kind) in enumerate(KINDS.items())],
    )  # fmt: skip
    who: EnumProperty(name="Who", description="Actor that does it", items=WHO, options={"SKIP_SAVE"})
    side: EnumProperty(name="Side", description="Where the actor comes from", items=SIDES, options={"SKIP_SAVE"})
    left_m: in_metres(
        "Sideways", "Distance to the left; negative values are to the right", 3.5, soft_min=-8.0, soft_max=8.0
    )
    gap_by: EnumProperty(name="Gap", description="How the gap is given", items=GAPS, options={"SKIP_SAVE"})
    gap_s: in_seconds("Gap", "Time from the front of the vehicle behind to the actor", 1.5, min=0.0, soft_max=5.0)
    gap_m: in_metres("Gap", "Distance from the front of the vehicle behind to the actor", 10.0, min=0.0, soft_max=50.0)
    timed: BoolProperty(
        name="Set Duration",
        description="Give the duration of the lane change; comfortable otherwise",
        options={"SKIP_SAVE"},
    )
    duration_s: in_seconds("Duration", "Duration of the lane change", 4.0, min=0.5, soft_max=10.0)
    deceleration_m_s2: in_m_s2("Deceleration", "Deceleration while it brakes", 2.0, min=0.1, soft_max=10.0)
    speed_m_s: in_m_s("Speed", "Speed across the path, or after braking", min=0.0, soft_max=15.0)
    from_m: in_metres(
        "Stands Aside", "Distance from the path at which it stands before and after", 6.0, min=1.0, soft_max=30.0
    )
    count: IntProperty(
        name="Copies", description="Number of copies", default=3, min=1, soft_max=10, options={"SKIP_SAVE"}
    )
    tried: BoolProperty(options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        return KINDS[properties.kind].about

    def settings(self, **given: Any) -> dict[str, Any]:
        """Return the settings that the maneuver has, of other values where these are ``given``: one of both gaps, and a
        duration only where it is set."""
        values = {name: given.get(name, getattr(self, name)) for name in KINDS[self.kind].settings}
        if "gap_by" in values:
            del values["gap_m" if values["gap_by"] == "TIME" else "gap_s"]
        if not values.get("timed"):
            values.pop("duration_s", None)
        return values

    def draw(self, context: bpy.types.Context) -> None:
        draw_split(self)
        for name in self.settings():
            if name == "first_s":
                self.layout.prop(self, name, text="On the Path At" if self.kind == "CROSS" else "From")
            else:
                self.layout.prop(self, name)

    def values(self, **given: Any) -> dict[str, Any]:
        """Return the maneuver as JSON, of other numbers where these are ``given``."""
        settings = self.settings(**given)
        side = settings.get("side", "OWN")
        numbers = {name: round(value, 5) for name, value in settings.items() if isinstance(value, float)}
        values = {"type": self.kind.lower(), "at_s": numbers.pop("first_s"), **numbers}
        return values if side == "OWN" else {**values, "side": side.lower()}

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """Let it do the maneuver, with the first numbers for which there is room where none were given."""
        source = source_of(context.scene)
        clock, actors = Clock.of(source.drive), chosen(context, "ACTOR")
        if self.kind == "CROSS" and not self.properties.is_property_set("first_s"):
            self.start_at(context.scene, clock)
            self.first_s = max(min(self.first_s + LEAD_S, float(clock.times_s[-1]) - 1.0), self.first_s)
        self.start_at(context.scene, clock)
        self.first_s = self.start_s(clock)
        active = next((obj for obj in actors if obj == context.active_object), actors[0] if actors else None)
        groups = KINDS[self.kind].groups
        if not groups:
            if active is None:
                raise UnisimError(message("Select a moving actor first"))
            changed = self.platoon(context, active) if self.kind == "PLATOON" else [active]
        else:
            fits = active is not None and group_of(class_of(active, source.drive)) in groups
            if not self.properties.is_property_set("who"):
                self.who = "SELECTED" if fits else "NEW"
            if self.who == "SELECTED" and active is None:
                raise UnisimError(message("Select an actor first"))
            changed = [active if self.who == "SELECTED" else self.inserted(context, groups)]
        if self.kind != "PLATOON":
            self.report_on(changed[0], self.maneuver(context, changed[0]))
        return changed

    def maneuver(self, context: bpy.types.Context, obj: bpy.types.Object) -> Any:
        """Let an object do the maneuver, and return how; the first time, the first numbers with room are chosen."""
        label = class_of(obj, source_of(context.scene).drive)
        before, habits = Maneuvering.of(context.scene, obj), habits_of(label)
        if not self.tried:
            self.tried, sides = True, ["LEFT", "RIGHT"]
            tried = FIRST.get(self.kind, [{}])
            if self.kind == "CROSS":
                sides, group = ["RIGHT", "LEFT"], group_of(label)
                speed = habits.speed_m_s
                room = (Vehicle().width_m + float(before.context.here.size_m[1])) / 2 + BESIDE_M
                tried = [
                    {"gap_by": "TIME", "gap_s": round(more * room / speed, 1), "speed_m_s": speed, "from_m": aside}
                    for aside, more in FIRST.get(group, FIRST["PERSON"])
                ]
            if self.kind == "BRAKE":
                tried = [{"deceleration_m_s2": habits.comfortable_m_s2}]
            rounds = [tried]
            if KINDS[self.kind].groups:
                rounds = [[{"side": side, **numbers} for side in sides for numbers in tried]]
                if self.kind == "CUT_IN" and self.who == "SELECTED":  # from where it drives, if it can
                    rounds.insert(0, [{"side": "OWN", **numbers} for numbers in tried])
            self.choose_numbers(before, rounds)
        return before, before.apply(self.values())

    def choose_numbers(self, before: Maneuvering, rounds: list[list[dict[str, Any]]]) -> None:
        """Set the numbers to the first that can be and that have room; a later round only where a former one has none that
        can be. Numbers that were given stay."""
        faults, traffic = [], traffic_of(before.obj)
        for numbers in rounds:
            free = [{k: v for k, v in each.items() if not self.properties.is_property_set(k)} for each in numbers]
            try:
                best = before.first_clear([self.values(**each) for each in free], traffic)
            except UnisimError as fault:
                faults.append(fault)
                continue
            for name, value in free[best].items():
                setattr(self, name, value)
            return
        raise faults[-1]

    def inserted(self, context: bpy.types.Context, groups: tuple[str, ...]) -> bpy.types.Object:
        """Return a new actor, like the best seen one of the first group that the drive has, ahead of the ego vehicle."""
        source, choice = source_of(context.scene), choice_of(context, "")
        uids = next((uids for group in groups if (uids := listed(choice, group))), [])
        if not uids:
            if self.kind == "CUT_IN":
                raise UnisimError(message("This drive has no vehicle"))
            raise UnisimError(message("This drive has no pedestrian or cyclist"))
        clock, uid = Clock.of(source.drive), best_seen(source.drive, uids)
        pose = ego_poses(context.scene, source.drive, clock)[clock.index(float(clock.frame(np.array(self.first_s))))]
        pose[:3, 3] += (FRONT_M + GROUND_M) * pose[:3, 0]
        obj = inserted_at(context.scene, source, choice.names[uid], uid, pose, int(clock.frames[clock.index(0)]))
        choose(context, obj)
        return obj

    def platoon(self, context: bpy.types.Context, leader: bpy.types.Object) -> list[bpy.types.Object]:
        """Return copies of an actor, each of which follows the one before."""
        copies = [leader]
        for name, value in PLATOON.items():
            if not self.properties.is_property_set(name):
                setattr(self, name, value)
        gaps = {name: round(getattr(self, name), 5) for name in PLATOON}
        for _ in range(self.count):
            ahead, copy = copies[-1], copy_of(context, copies[-1])
            copy.unisim.maneuvers = ""
            values = {"type": "follow", "leader": scenario_id(context.scene, ahead), **gaps}
            try:
                before = Maneuvering.of(context.scene, copy, ahead)
                actor = before.apply(values)
            except UnisimError:
                bpy.data.objects.remove(copy)
                raise
            copies.append(copy)
            self.report_on(copy, (before, actor))
        choose(context, *copies[1:])
        return copies[1:]

    def report_on(self, obj: bpy.types.Object, done: tuple[Maneuvering, Any]) -> None:
        """Say what an actor does, and what is in its way."""
        before, actor = done
        note = ManeuverNote.of(obj.unisim.maneuvers)
        assert note is not None  # it was just noted
        said = series([obj.name, maneuver_words(note.edits(before.uid)[-1])], ": ")
        overlap = before.first_overlap(actor, traffic_of(before.obj))
        if overlap is None:
            self.report({"INFO"}, localized(said))
        else:
            said = Text("{said}; overlaps {other} at {time:.1f} s", said=said, other=overlap[0], time=overlap[1])
            self.report({"WARNING"}, localized(said))


HANDLES = {
    "cut_in": ("gap_s", "gap_m", "at_s"),
    "cross": ("gap_s", "gap_m"),
    "lane_change": ("left_m", "at_s"),
    "brake": ("deceleration_m_s2", "at_s"),
    "follow": ("gap_m",),
}
"""Numbers of a maneuver that handles drag."""
STEPS = {"_m": 0.5, "_s": 0.1, "_s2": 0.1}
"""Steps of a number while Ctrl is held, by the end of its name."""


def handle_time(values: Mapping[str, Any], name: str, clock: Clock) -> float:
    """Return the time at which an actor's place shows a number of its maneuver."""
    start, last = float(values.get("at_s", 0.0)), float(clock.times_s[-1])
    if name == "at_s" or values["type"] == "cross":
        return start
    return min(start + float(values["duration_s"]), last) if "duration_s" in values else last


def maneuver_handles(obj: bpy.types.Object, clock: Clock) -> list[tuple[str, FloatArray]]:
    """Return the numbers of an actor's last maneuver that can be dragged, each with a place (3,) above the actor."""
    note = ManeuverNote.of(obj.unisim.maneuvers)
    values = note.maneuvers[-1] if note is not None else {"type": ""}
    handles = []
    for name in HANDLES.get(values["type"], ()):
        if name in values:
            pose = keyed_pose(obj, float(clock.frame(np.array(handle_time(values, name, clock)))))
            handles.append((name, pose[:3, 3] + [0.0, 0.0, float(size_of(obj)[2]) / 2 + ABOVE_M]))
    return handles


ABOVE_M = 0.7
"""How high handles are above an actor: those of its trajectory are in its middle."""


class UNISIM_OT_drag_maneuver(Needing, Dragged, bpy.types.Operator):
    """Drag a number of the active actor's maneuver: its gap, distance or deceleration, or when it begins"""

    bl_label = "Change Maneuver"
    needs = (object_mode, selected("Select an actor first", "ACTOR"))

    number: StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    value: FloatProperty(name="Value", description="Number of the maneuver", options={"SKIP_SAVE"})

    def note(self, context: bpy.types.Context) -> None:
        """Note the maneuver, and how its place moves with the number."""
        scene, obj = context.scene, self.subject(context)
        actors = list(imported_objects(scene, "ACTOR"))
        note = ManeuverNote.of(obj.unisim.maneuvers)
        leaders = {values.get("leader") for values in note.maneuvers} if note is not None else set()
        self.before = Maneuvering.of(scene, obj, *(one for one in actors if scenario_id(scene, one) in leaders))
        if not self.before.note.maneuvers:
            raise UnisimError(message("The actor was moved since its maneuver"))
        self.values, self.before = self.before.note.maneuvers[-1], self.before.without_last()
        self.first = float(self.values[self.number])
        self.origin = self.place(self.first)
        change = 0.05 if self.place(self.first + 0.05) is not None else -0.05
        self.slope = (self.place(self.first + change) - self.origin) / change

    def place(self, value: float) -> Any:
        """Return where the actor is that shows the number (3,); None where the maneuver cannot be."""
        values = {**self.values, self.number: value}
        try:
            actor, _ = self.before.after(values)
        except UnisimError:
            return None
        return actor.world_from_actor.at(handle_time(values, self.number, self.before.context.clock))[:3, 3]

    def follow(self, context: bpy.types.Context, pressed: FloatArray, mouse: FloatArray, in_steps: bool) -> None:
        """Set the number to what the mouse moved in the plane of the ground."""
        moved = self.dragged(context, pressed, mouse)
        if moved is not None:
            away = float(moved @ self.slope / max(float(self.slope @ self.slope), 1e-6))
            step = STEPS[next(end for end in ("_s2", "_s", "_m") if self.number.endswith(end))]
            self.value = stepped(self.first + away, step, in_steps)

    def apply(self, context: bpy.types.Context) -> None:
        """Do the maneuver with the number, or as it was where it cannot be."""
        self.fault = ""
        try:
            self.before.apply({**self.values, self.number: round(self.value, 4)})
        except UnisimError as fault:
            self.fault = str(fault)
            self.before.apply(self.values)

    def restore(self) -> None:
        self.before.apply(self.values)

    def said(self, context: bpy.types.Context) -> str:
        note = ManeuverNote.of(self.subject(context).unisim.maneuvers)
        assert note is not None  # it was just noted
        return self.fault or series([self.subject(context).name, maneuver_words(note.edits(self.before.uid)[-1])], ": ")


class UNISIM_GGT_maneuver(Handles, bpy.types.GizmoGroup):
    """Handles for the numbers of the active actor's last maneuver"""

    bl_label = "Maneuver"
    operator, size, colour = "unisim.drag_maneuver", 0.13, (1.0, 0.45, 0.1)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = context.active_object
        return bool(are_shown(context) and obj is not None and obj.unisim.maneuvers and obj.select_get())

    def places(self, context: bpy.types.Context) -> Iterator[tuple[FloatArray, dict[str, Any]]]:
        obj, recorded = context.active_object, drive_of(context.scene)
        if obj is not None and recorded is not None:
            yield from ((place, {"number": name}) for name, place in maneuver_handles(obj, Clock.of(recorded)))
