"""The lines of the edits list: what of a sampled scene is edited, in words, and from when to when.

They are made of the same edits that a scenario is, one line for each. Nothing here needs Blender.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..core.actor_images.names import plain_names
from ..core.errors import ScenarioError
from ..core.geometry import BoolArray, FloatArray, Trajectory, invert_pose
from ..core.scenario.types import (
    CameraSpec,
    CopyStatic,
    Duplicate,
    Edit,
    Insert,
    InsertMesh,
    LidarSpec,
    Move,
    Offset,
    Remove,
    RemoveStatic,
    Scale,
    Swap,
)
from ..core.world.drive import Actor, Drive
from .clock import Clock
from .edit_words import degrees, displaced_words, joined, moved_words, presence_words, trajectory_words
from .poses import same
from .read_actors import actor_edits, look_size_m, original, recorded_poses, recorded_there
from .read_body import body_edits
from .read_rig import ego_edits, sensors_of
from .read_static import static_edits
from .sampling import Sampled, Thing
from .scaling import scale_text

ICONS = {
    "REMOVE": "TRASH", "APPEARANCE": "SHADING_TEXTURE", "MOVE": "ORIENTATION_GLOBAL", "COPY": "DUPLICATE", "INSERT": "ADD",
    "MESH": "MESH_MONKEY", "SCALE": "FULLSCREEN_ENTER", "BODY": "AUTO", "SENSOR": "CAMERA_DATA", "EGO": "AUTO",
    "PROBLEM": "ERROR",
}  # fmt: skip
"""By the part of an object that an edit changes."""
ADDED = ("COPY", "INSERT", "MESH", "BODY")
"""Parts that are an object of their own: without the edit there is none."""
RETIMED_FRAMES = 0.02
"""Trajectories whose first or last key is this far from the recorded one are retimed."""


@dataclass(frozen=True)
class Line:
    """One edit. ``who`` is the object's name as the scenario has it, ``thing`` as Blender has it, "" where it is not
    there.

    ``frames`` are those at which the edit shows, ``start_s`` and ``end_s`` the times of the first and the last.
    ``edit`` is what
    the scenario holds. ``muted`` is the number of the muted edit, -1 where it is not muted.
    """

    kind: str
    uid: str
    part: str
    what: str
    who: str
    thing: str
    start_s: float
    end_s: float
    frames: tuple[int, ...]
    edit: object = None
    muted: int = -1

    @property
    def icon(self) -> str:
        """Name of the icon."""
        return "TIME" if self.part == "MOVE" and self.what.startswith("Retimed") else ICONS[self.part]

    @property
    def key(self) -> tuple[str, str, str]:
        """What tells the edit from the others of a scene, and is the same in every variant."""
        return self.kind, self.who if self.part in ADDED else self.uid, self.part


def actor_lines(uid: str, standing: list[Thing], drive: Drive, clock: Clock) -> Iterator[Line]:
    """Yield the edits of one recorded actor and its copies, or of the objects of an id that the drive does not
    have."""
    actor = drive.actors.get(uid)
    looks = {thing.look for thing in standing if thing.look and not thing.look_scene}
    few = replace(drive, actors={name: one for name, one in drive.actors.items() if name == uid or name in looks})
    sampled = Sampled("", clock, tuple(standing))
    own = original(standing, actor, clock) if actor is not None else None
    others = [thing for thing in standing if thing is not own and thing.there.any()]
    for edit in actor_edits(sampled, few, set(drive.actors), str):
        if isinstance(edit, Remove | Move | Swap):
            if edit.actor == uid and actor is not None:
                line = _own(edit, own, actor, drive, clock)
                yield from () if line is None else (line,)
        elif isinstance(edit, Scale):
            if edit.actor == uid and own is not None:  # a copy's scale is part of its own line
                words = f"Scaled by {scale_text(edit.factors)}"
                yield _line("ACTOR", uid, "SCALE", words, own.title, own.name, own.there, clock, edit)
        elif not isinstance(edit, Duplicate | Insert) or edit.actor in (uid, *looks, *(t.look for t in standing)):
            yield _added(edit, others.pop(0), actor, drive, clock)


def _own(edit: Edit, own: Thing | None, actor: Actor, drive: Drive, clock: Clock) -> Line | None:
    """Return the line of what became of a recorded actor; None where it was moved for its scale alone, which has a line of its
    own."""
    poses, there = recorded_poses(actor, clock), recorded_there(actor, drive, clock)
    who, thing = (own.title, own.name) if own is not None else (plain_names(drive.actors)[actor.uid], "")
    if isinstance(edit, Remove) or own is None:
        return _line("ACTOR", actor.uid, "REMOVE", "Removed", who, thing, there, clock, edit)
    if isinstance(edit, Swap):
        own_look = edit.scene is None and edit.look in drive.actors
        named = plain_names(drive.actors)[edit.look] if own_look else f"{edit.look} of {Path(edit.scene or '').name}"
        return _line("ACTOR", actor.uid, "APPEARANCE", f"Appearance of {named}", who, thing, own.there, clock, edit)
    lifted = poses.copy()
    if own.look:
        lifted[:, :3, 3] += (_height(own, drive) - float(actor.size_m[2])) / 2 * poses[:, :3, 2]
    lifted[:, :3, 3] += own.scale_lift_m * poses[:, :3, 2]
    differs = (own.there != there) | (own.there & ~same(own.poses, lifted))
    if own.scale_lift_m and not differs.any():
        return None
    words = _moved(own, poses, lifted, there, actor, clock)
    return _line("ACTOR", actor.uid, "MOVE", words or "Moved", who, thing, differs, clock, edit)


def _moved(thing: Thing, base: FloatArray, lifted: FloatArray, there: BoolArray, actor: Actor | None, clock: Clock) -> str:
    """Return how an object goes another way than ``base`` (N, 4, 4), which lies ``lifted`` for an object with
    another appearance or scale."""
    at = thing.there & there if (thing.there & there).any() else thing.there
    few = Clock(clock.frames[at], clock.times_s[at])
    parts = []
    if thing.ridden is not None and actor is not None:
        recorded = actor.world_from_actor
        parts.append(trajectory_words(few, thing.ridden[at], base[at], recorded, _retimed(thing, recorded, clock)))
        rise = invert_pose(base[at]) @ lifted[at]
        parts.append(displaced_words(invert_pose(thing.ridden[at] @ rise) @ thing.poses[at]))
    else:
        parts.append(trajectory_words(few, thing.poses[at], lifted[at], None, False))
    if (thing.there != there).any() and not any(part.startswith("Retimed") for part in parts):
        parts.append(presence_words(clock, thing.there))
    return joined(parts)


def _retimed(thing: Thing, recorded: Trajectory, clock: Clock) -> bool:
    """Return whether the keys of an object's trajectory lie at other times than the recorded ones."""
    keys = clock.frame(recorded.times_s[[0, -1]])
    return thing.span is not None and bool(np.abs(np.array(thing.span) - keys).max() > RETIMED_FRAMES)


def _added(edit: Edit, thing: Thing, source: Actor | None, drive: Drive, clock: Clock) -> Line:
    """Return the line of a copied or inserted actor."""
    if isinstance(edit, InsertMesh):
        return _line("ACTOR", thing.uid, "MESH", "Mesh inserted", thing.title, thing.name, thing.there, clock, edit)
    if isinstance(edit, Insert) or source is None:
        return _line("ACTOR", thing.uid, "INSERT", "Inserted", thing.title, thing.name, thing.there, clock, edit)
    base, there = recorded_poses(source, clock), recorded_there(source, drive, clock)
    lifted = base.copy()
    lifted[:, :3, 3] += thing.scale_lift_m * base[:, :3, 2]
    words = _moved(thing, base, lifted, there, source, clock)
    what = joined(["Copied", words.removeprefix("Moved ")]) if words else "Copied, in place"
    return _line(
        "ACTOR", thing.uid, "COPY", what.replace("Copied; ", "Copied: "), thing.title, thing.name, thing.there, clock, edit
    )


def rig_lines(sampled: Sampled, drive: Drive) -> Iterator[Line]:
    """Yield the edits of the ego vehicle and of its sensors."""
    clock, always = sampled.clock, np.ones(len(sampled.clock.frames), bool)
    for edit in ego_edits(sampled, drive):
        ego = next(sampled.of("EGO"))
        base = drive.world_from_ego.at(clock.times_s)
        if ego.ridden is not None:
            retimed = _retimed(ego, drive.world_from_ego, clock)
            words = joined(
                [
                    trajectory_words(clock, ego.ridden, base, drive.world_from_ego, retimed),
                    displaced_words(invert_pose(ego.ridden) @ ego.poses),
                ]
            )
        else:
            words = trajectory_words(clock, ego.poses, base, None, False)
        yield _line("EGO", "ego", "EGO", words or "Moved", ego.title, ego.name, ~same(ego.poses, base), clock, edit)
    bodies = [thing for thing in sampled.of("BODY") if thing.there.any()]
    for body, thing in zip(body_edits(sampled, set(), str), bodies, strict=True):
        yield _line("BODY", thing.uid, "BODY", "Body of the ego vehicle", thing.title, thing.name, thing.there, clock, body)
    sensors = sensors_of(sampled, drive)
    listed: dict[str, tuple[CameraSpec | LidarSpec, ...] | None] = {
        "CAMERA": sensors.cameras if sensors else None,
        "LIDAR": sensors.lidars if sensors else None,
    }
    for kind, specs in listed.items():
        if specs is None:
            continue
        recorded = set(drive.cameras if kind == "CAMERA" else drive.lidars)
        named = "Camera" if kind == "CAMERA" else "LiDAR"
        standing = [thing for thing in sampled.of(kind) if thing.there.any()]
        for name in sorted(recorded - {spec.id for spec in specs}):
            hidden = next((thing.name for thing in sampled.of(kind) if thing.uid == name and thing.is_original), "")
            yield _line(kind, name, "REMOVE", f"{named} removed", name, hidden, always, clock, name)
        for spec, thing in zip(specs, standing, strict=True):
            if spec in (CameraSpec(spec.id), LidarSpec(spec.id)) and spec.id in recorded:
                continue
            if spec.id in recorded and spec.like is None:
                yield _line(kind, spec.id, "SENSOR", sensor_words(named, spec), thing.title, thing.name, always, clock, spec)
            else:
                what = f"{named} copied" if spec.like else f"{named} added"
                yield _line(kind, thing.uid, "INSERT", what, thing.title, thing.name, always, clock, spec)


def sensor_words(named: str, spec: CameraSpec | LidarSpec) -> str:
    """Return what of a recorded sensor is another one."""
    words = []
    if spec.trajectory is not None:
        words.append("on a trajectory of its own")
    if spec.mount_offset is not None:
        words.append(offset_words(spec.mount_offset))
    if isinstance(spec, CameraSpec) and (spec.width or spec.fx):
        words.append("another lens")
    if isinstance(spec, LidarSpec) and spec.elevation_deg is not None:
        words.append("other beams")
    return f"{named}: {', '.join(words)}"


def offset_words(offset: Offset) -> str:
    """Return how far a sensor's mount is displaced along the vehicle's axes, and whether it is turned."""
    apart = np.eye(4)
    apart[:3, 3] = offset.position or (0.0, 0.0, 0.0)
    words = [moved_words(apart)] if offset.position else []
    if offset.quaternion_wxyz is not None:
        words.append(f"turned by {degrees(float(np.degrees(2 * np.arccos(np.clip(abs(offset.quaternion_wxyz[0]), 0, 1)))))}")
    return ", ".join(words)


def static_lines(sampled: Sampled, drive: Drive) -> Iterator[Line]:
    """Yield the edits of static items. An item that is moved is removed and copied in a scenario; it is one line."""
    clock, always = sampled.clock, np.ones(len(sampled.clock.frames), bool)
    boxes, edits = static_edits(sampled, {*drive.actors, *(thing.uid for thing in sampled.of("STATIC"))})
    for uid in boxes:
        standing = [thing for thing in sampled.of("STATIC") if thing.uid == uid and thing.there.any()]
        own = next((thing for thing in standing if thing.is_original), None)
        of = [edit for edit in edits if getattr(edit, "box", "") == uid]
        copies = [edit for edit in of if isinstance(edit, CopyStatic)]
        gone = any(isinstance(edit, RemoveStatic) for edit in of)
        copied = [thing for thing in standing if not (thing is own and not gone)]
        for edit, thing in zip(copies, copied, strict=True):
            home = np.eye(4)
            home[:3, 3] = boxes[uid].position
            apart = np.eye(4)
            apart[:3, 3] = thing.poses[0, :3, 3] - home[:3, 3]
            far = f"{np.linalg.norm(apart[:3, 3]):.1f} m away"
            if thing is own:
                yield _line("STATIC", uid, "MOVE", f"Moved {far}", thing.title, thing.name, always, clock, edit)
            else:
                yield _line("STATIC", uid, "COPY", f"Copied: {far}", thing.title, thing.name, always, clock, edit)
        if gone and own is None:
            hidden = next((thing.name for thing in sampled.of("STATIC") if thing.uid == uid and thing.is_original), "")
            yield _line("STATIC", uid, "REMOVE", "Removed", uid, hidden, always, clock, RemoveStatic(uid))


def problem_line(kind: str, uid: str, fault: ScenarioError, things: Iterable[Thing]) -> Line:
    """Return the line of what keeps a scene from being read."""
    thing = next((thing for thing in things if f'"{thing.name}"' in str(fault)), None)
    text, title, name = str(fault).split(": ", 1)[-1], "", ""
    if thing is not None:
        title, name = thing.title, thing.name
    return Line(kind, uid, "PROBLEM", text[0].upper() + text[1:], title, name, 0.0, 0.0, ())


def _height(thing: Thing, drive: Drive) -> float:
    return float(look_size_m(thing, drive)[2])


def _line(kind: str, uid: str, part: str, what: str, who: str, thing: str, shows: BoolArray, clock: Clock, edit: object) -> Line:
    at = np.flatnonzero(shows) if shows.any() else np.arange(len(clock.frames))
    frames = tuple(int(frame) for frame in clock.frames[at])
    return Line(kind, uid, part, what, who, thing, float(clock.times_s[at[0]]), float(clock.times_s[at[-1]]), frames, edit)
