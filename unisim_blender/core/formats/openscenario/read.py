"""Read OpenSCENARIO: where each entity is, and when, as edits of a log's scenario. What is not understood is listed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ...errors import ScenarioError, short
from ...geometry import FloatArray, Trajectory, invert_pose, quaternion_from_matrix
from ...scenario.checks import listed
from ...scenario.edit import Edit
from ...scenario.edits.duplicate import Duplicate
from ...scenario.edits.ego import Ego
from ...scenario.edits.move import Move
from ...scenario.edits.remove import Remove
from ...scenario.motion.keys import Keyframe, Present
from ...scenario.motion.placement import Placement
from ...world.drive import EGO, Actor, Drive
from .document import Document, NotUnderstoodError, parsed
from .entities import Entity, EntityTrack
from .paths import EGO_NAMES, EgoVehicle, box_centre, ego_centre, pose_at, shifted
from .storyboard import Size, Storyboard
from .write import EGO_HEIGHT_M, kind_of

SAME_M, SAME_RAD, SAME_S = 1e-3, 1e-4, 1e-3
"""Differences from the log, metres, radians and seconds, below which there is no edit."""
SAME_SIZE_M = 0.05
UNKNOWN_SIZE_M = (4.5, 1.8, 1.5)
"""Of an entity that neither the file nor the log has a box of."""
LONGEST_LIST = 200
"""Number of sentences that are given at most."""


@dataclass
class StoryboardEdits:
    """The edits that a file asks for, and a sentence for each part of it that is not understood."""

    edits: list[Edit] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)


def read(
    path: Path, drive: Drive, vehicle: EgoVehicle, actors: Mapping[str, str]
) -> tuple[list[Edit], tuple[str, ...]]:
    """Return the edits that make a drive what an OpenSCENARIO file says, and a sentence for each part of the file that is not
    understood. ``actors`` are the log's by entities' names, beside those of the same name. Raises `ScenarioError`."""
    result = edits_of(parsed(path), drive, vehicle, path, actors)
    losses = result.losses[:LONGEST_LIST]
    if len(result.losses) > LONGEST_LIST:
        losses.append(f"{len(result.losses) - LONGEST_LIST} more parts are not understood")
    return result.edits, tuple(losses)


def edits_of(
    root: Element, drive: Drive, vehicle: EgoVehicle, path: Path, actors: Mapping[str, str]
) -> StoryboardEdits:
    """Return the edits that make a drive what an OpenSCENARIO file says, and what of it is not understood. Actors that the file
    does not have are removed. Raises `ScenarioError` for numbers that are none."""
    result, document = StoryboardEdits(), Document(path, root)
    names = [entity_element.get("name", "") for entity_element in root.findall("Entities/ScenarioObject")]
    uids = _mapped(names, drive, path, actors)

    def describe(name: str, centre: Size | None, its_height: float | None) -> tuple[Size, Size, Trajectory | None]:
        uid = uids.get(name)
        if uid == EGO:
            axle = drive.world_from_ego.transformed(right=vehicle.ego_from_axle)
            size = vehicle.length_m, vehicle.width_m, EGO_HEIGHT_M
            return centre or ego_centre(vehicle, EGO_HEIGHT_M), size, axle
        if uid is None:
            return centre or (0.0, 0.0, 0.0), UNKNOWN_SIZE_M, None
        actor = drive.actors[uid]
        length, width, height = actor.size_m.tolist()
        if centre is not None and its_height is not None:
            # the log's box is kept, and stands where the file's does
            centre = centre[0], centre[1], centre[2] + (height - its_height) / 2
        centre = centre or box_centre(actor, kind_of(actor, None)[0] == "vehicle")
        return centre, (length, width, height), actor.world_from_actor.transformed(right=invert_pose(shifted(centre)))

    span_s = min(drive.time_s.values()), max(drive.time_s.values())
    ego = next((name for name, uid in uids.items() if uid == EGO), None)
    try:
        board = Storyboard(document, span_s, ego, describe)
    except NotUnderstoodError as fault:
        raise ScenarioError(f"{path}: {fault} is not understood") from None
    for name, tracks in board.run().items():
        entity, uid = board.entities[name], uids.get(name)
        _say_of(entity, span_s, document)
        if uid is None:
            document.say(
                f"entity {short(name)}: the log has no such actor: it is left out (--map '{name}=ACTOR' gives one)"
            )
        elif uid == EGO:
            _say_box(entity, (vehicle.length_m, vehicle.width_m, EGO_HEIGHT_M), "the recording vehicle", document)
            _edit_ego(tracks, drive, vehicle, result, span_s)
        else:
            _edit_actor(entity, tracks, drive.actors[uid], drive, result, document)
    if board.stops_s is not None and board.stops_s < span_s[1] - SAME_S:
        document.say(f"Storyboard: StopTrigger is met at {board.stops_s:.3g} s: the drive goes on to {span_s[1]:.3g} s")
    for uid, actor in sorted(drive.actors.items()):
        if uid not in uids.values() and not actor.is_ego_body:
            result.edits.append(Remove(actor=uid))
    result.losses = document.losses()
    return result


def _mapped(names: list[str], drive: Drive, path: Path, actors: Mapping[str, str]) -> dict[str, str]:
    """Return the actors of entities, `EGO` for the recording vehicle. Raises `ScenarioError`."""
    known = sorted(uid for uid, actor in drive.actors.items() if not actor.is_ego_body)
    for name, actor in actors.items():
        if name not in names:
            raise ScenarioError(f"{path}: --map {name}={actor}: there is no entity {short(name)} {listed(names)}")
        if actor != EGO and actor not in known:
            raise ScenarioError(
                f"{path}: --map {name}={actor}: no actor {short(actor)} in the log {listed([EGO, *known])}"
            )
    uids: dict[str, str] = {}
    for name in names:
        # the first of several that may be the recording vehicle is it
        is_ego = name in EGO_NAMES and all(other_name not in EGO_NAMES for other_name in uids)
        own = name if name in known else EGO if is_ego else None
        uid = actors.get(name, own)
        if uid is None:
            continue
        twin = next((other for other, its in uids.items() if its == uid), None)
        if twin is not None:
            raise ScenarioError(f"{path}: the entities {short(twin)} and {short(name)} are both {uid} of the log")
        uids[name] = uid
    return uids


def _say_of(entity: Entity, span_s: tuple[float, float], document: Document) -> None:
    """Say where an entity's motion is not what its file may lead to expect."""
    name = f"entity {short(entity.name)}"
    if entity.backs:
        document.say(
            f"{name}: its speed on a trajectory becomes negative: it backs from where it is, away from the trajectory's end"
        )
    for time_s, away_m in entity.jumps[:3]:
        document.say(f"{name}: jumps by {away_m:.3g} m at {time_s:.3g} s")
    if entity.cut_s is not None:
        document.say(
            f"{name}: its trajectory goes on until {entity.cut_s:.3g} s: it is cut at the log's end, {span_s[1]:.3g} s"
        )
    if entity.pending is not None:
        begins = float(entity.pending.times_s[0])
        document.say(
            f"{name}: its trajectory begins at {begins:.3g} s, after the log's end, {span_s[1]:.3g} s: it is left out"
        )


def _say_box(entity: Entity, logged_m: Sequence[float], uid: str, document: Document) -> None:
    """Say where an entity's box is not the one of the log, which is kept."""
    if entity.says_size and max(abs(a - b) for a, b in zip(entity.size_m, logged_m, strict=True)) > SAME_SIZE_M:
        its, own = (" x ".join(f"{extent:.3g}" for extent in size) for size in (entity.size_m, logged_m))
        document.say(f"entity {short(entity.name)}: its box of {its} m is not read: {uid} keeps its own of {own} m")


def _edit_ego(
    tracks: list[EntityTrack], drive: Drive, vehicle: EgoVehicle, result: StoryboardEdits, span_s: tuple[float, float]
) -> None:
    ego_from_axle = invert_pose(vehicle.ego_from_axle)
    (track,) = tracks
    times, poses = track.times_s, [pose_at(place) @ ego_from_axle for place in track.places]
    if poses and not _same(times, poses, drive.world_from_ego, span_s):
        result.edits.append(Ego(trajectory=_keys(times, poses), outside="continue"))


def _edit_actor(
    entity: Entity, tracks: list[EntityTrack], actor: Actor, drive: Drive, result: StoryboardEdits, document: Document
) -> None:
    uid, first, last = actor.uid, *entity.span_s
    # what vanishes as the drive begins was never there
    tracks = [part for part in tracks if part.vanishes_s is None or part.vanishes_s > first + SAME_S]
    if not tracks:
        document.say(f"entity {short(entity.name)}: it never appears")
        result.edits.append(Remove(actor=uid))
        return
    _say_box(entity, actor.size_m.tolist(), uid, document)
    start, end = drive.window(actor)
    for number, track in enumerate(tracks):
        poses = [pose_at(place) @ shifted(entity.centre) for place in track.places]
        times, present = track.times_s, None
        appears = first if track.appears_s is None else track.appears_s
        vanishes = last if track.vanishes_s is None else track.vanishes_s
        if abs(max(start, first) - appears) > SAME_S or abs(min(end, last) - vanishes) > SAME_S or number:
            present = Present(track.appears_s, track.vanishes_s)
        elif not poses or _same(times, poses, actor.world_from_actor, entity.span_s):
            continue
        if not poses:
            poses, times = list(actor.world_from_actor.poses), actor.world_from_actor.times_s.tolist()
        path: dict[str, Any] = {"trajectory": _keys(times, poses)}
        if len(poses) == 1:
            position, quaternion = _placed(poses[0])
            path = {"pose": Placement(position=position, quaternion_wxyz=quaternion)}
        if not number:
            result.edits.append(Move(actor=uid, present=present, **path))
            continue
        again = next(free for free in (f"{uid}-{n}" for n in range(number + 1, 10_000)) if free not in drive.actors)
        document.say(
            f"entity {short(entity.name)}: it appears again at {appears:.3g} s: as a duplicate of {uid}, {again}"
        )
        result.edits.append(Duplicate(actor=uid, id=again, present=present, **path))


def _same(times_s: list[float], poses: list[FloatArray], recorded: Trajectory, span_s: tuple[float, float]) -> bool:
    """Return whether poses are the recorded ones at their times, and between them at the recorded keys'; a single pose is one
    that stands throughout ``span_s``."""
    ours = Trajectory.from_poses(np.array(times_s), np.stack(poses))
    first, last = span_s if len(times_s) == 1 else (times_s[0], times_s[-1])
    between = recorded.times_s[(recorded.times_s > first) & (recorded.times_s < last)]
    at = np.concatenate([times_s, [first, last], between])
    here, there = ours.at(at), recorded.at(at)
    near = np.abs(here[:, :3, 3] - there[:, :3, 3]).max() < SAME_M
    return bool(near and np.abs(here[:, :3, :3] - there[:, :3, :3]).max() < SAME_RAD)


def _keys(times_s: list[float], poses: list[FloatArray]) -> tuple[Keyframe, ...]:
    keys = []
    for time_s, pose in zip(times_s, poses, strict=True):
        position, quaternion = _placed(pose)
        keys.append(Keyframe(position=position, quaternion_wxyz=quaternion, time_s=time_s))
    return tuple(keys)


def _placed(pose: FloatArray) -> tuple[Any, Any]:
    return tuple(pose[:3, 3].tolist()), tuple(quaternion_from_matrix(pose[:3, :3]).tolist())
