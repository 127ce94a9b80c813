"""Edits of actors: remove, duplicate, insert, insert_mesh, move, retime, swap, scale."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import ScenarioError, UnisimError
from ...geometry import FloatArray, Trajectory, quaternion_from_yaw
from ...meshes.read import mesh_size_m
from ...world.drive import Actor, Drive, Look
from ..checks import UNSCALABLE, scales
from ..types import Duplicate, Insert, InsertMesh, Move, Remove, Retime, Scale, Swap
from .context import Context, actor_of, fail
from .motion import TimeMap, displaced, is_moving, offset_curve, quaternion_product, retimed

MESH_LABEL = "Other"
"""The class of a mesh whose class nobody told."""


def remove(drive: Drive, edit: Remove, place: str, context: Context) -> Drive:
    """The drive without the actor."""
    current(drive, edit.actor, f"{place}.actor", context)
    return replace(drive, actors={uid: actor for uid, actor in drive.actors.items() if uid != edit.actor})


def duplicate(drive: Drive, edit: Duplicate, place: str, context: Context) -> Drive:
    """The drive with a second actor that looks like the source, displaced, later, or on a path of its own."""
    source = current(drive, edit.actor, f"{place}.actor", context)
    check_new(drive, edit.id, place, context)
    if edit.pose is not None or edit.trajectory is not None:
        trajectory = context.trajectory(edit.pose, edit.trajectory, edit.outside, place)
        start, end = source.start_s, source.end_s
    else:
        trajectory = beside(source.world_from_actor, edit.offset_m, edit.world_offset_m, edit.turn_deg)
        later = edit.time_offset_s or 0.0
        trajectory = retimed(trajectory, TimeMap(np.array([later]), np.zeros(1))) if later else trajectory
        start, end = source.start_s + later, source.end_s + later
    if edit.present is not None:
        start, end = context.presence(edit.present, place)
    return _with(drive, _newcomer(source, edit.id, trajectory, start, end))


def insert(drive: Drive, edit: Insert, place: str, context: Context) -> Drive:
    """The drive with another actor, of this or of another trained scene."""
    source = context.look_of(edit.actor, edit.scene, place, "actor")
    check_new(drive, edit.id, place, context)
    trajectory = context.trajectory(edit.pose, edit.trajectory, edit.outside, place)
    start, end = context.presence(edit.present, place)
    return _with(drive, _newcomer(source, edit.id, trajectory, start, end))


def insert_mesh(drive: Drive, edit: InsertMesh, place: str, context: Context) -> Drive:
    """The drive with a mesh in it; its box is the mesh's extent."""
    path, size_m = mesh_of(edit.mesh, place, context)
    check_new(drive, edit.id, place, context)
    trajectory = context.trajectory(edit.pose, edit.trajectory, edit.outside, place)
    start, end = context.presence(edit.present, place)
    label, moving, look = edit.label or MESH_LABEL, is_moving(trajectory), Look(edit.id, mesh=str(path))
    return _with(drive, Actor(edit.id, label, size_m, trajectory, start, end, moving, look, inserted=True))


def mesh_of(name: str, place: str, context: Context) -> tuple[Path, FloatArray]:
    """The file of a mesh that a scenario names, and its extent (3,). Raises `ScenarioError`."""
    path = context.scenario.resolve(name)
    try:
        return path, mesh_size_m(path)
    except UnisimError as fault:
        raise ScenarioError(f"{place}.mesh: {fault}") from fault


def _newcomer(source: Actor, uid: str, trajectory: Trajectory, start_s: float, end_s: float) -> Actor:
    """An actor that the recording does not have, with the source's look."""
    moving = is_moving(trajectory)
    return replace(source, uid=uid, world_from_actor=trajectory, start_s=start_s, end_s=end_s, is_moving=moving, inserted=True)


def move(drive: Drive, edit: Move, place: str, context: Context) -> Drive:
    """The drive with the actor on another path; it is there when it was, unless the edit says when."""
    actor = current(drive, edit.actor, f"{place}.actor", context)
    trajectory = context.trajectory(edit.pose, edit.trajectory, edit.outside, place)
    start, end = (actor.start_s, actor.end_s) if edit.present is None else context.presence(edit.present, place)
    return _with(drive, replace(actor, world_from_actor=trajectory, start_s=start, end_s=end, is_moving=is_moving(trajectory)))


def retime(drive: Drive, edit: Retime, place: str, context: Context) -> Drive:
    """The drive with the actor on the same path at other times."""
    actor = current(drive, edit.actor, f"{place}.actor", context)
    time_map = _time_map(edit, place, context)
    start, end = context.presence(None, place)
    if edit.outside == "hold":
        time_map = time_map.clamped(actor.start_s, actor.end_s)
    elif edit.outside != "continue":
        start, end = time_map.scenario(actor.start_s), time_map.scenario(actor.end_s, latest=True)
    return _with(drive, replace(actor, world_from_actor=retimed(actor.world_from_actor, time_map), start_s=start, end_s=end))


def swap(drive: Drive, edit: Swap, place: str, context: Context) -> Drive:
    """The drive with another look in the actor's place: the look's box and class, its underside where the actor's was. A scale
    that the actor had before is not the new look's."""
    actor = current(drive, edit.actor, f"{place}.actor", context)
    look = context.look_of(edit.look, edit.scene, place, "look")
    raised = (look.size_m[2] - actor.size_m[2]) / 2
    trajectory = beside(actor.world_from_actor, (0.0, 0.0, raised), None, None) if raised else actor.world_from_actor
    return _with(
        drive,
        replace(actor, label=look.label, size_m=look.size_m, look=look.look, world_from_actor=trajectory, scale=(1.0, 1.0, 1.0)),
    )


def scale(drive: Drive, edit: Scale, place: str, context: Context) -> Drive:
    """The drive with the actor larger or smaller about its box's centre, after what earlier edits scaled it by."""
    actor = current(drive, edit.actor, f"{place}.actor", context)
    total = actor.scale[0] * edit.factors[0], actor.scale[1] * edit.factors[1], actor.scale[2] * edit.factors[2]
    if not scales(total):
        sizes = [round(factor, 6) for factor in total]
        fail(f"{place}.factors", f'with the edits before, "{edit.actor}" is scaled by {sizes}, which {UNSCALABLE}')
    return _with(drive, replace(actor, size_m=actor.look_size_m * np.array(total), scale=total))


def beside(
    trajectory: Trajectory,
    offset_m: tuple[float, float, float] | None,
    world_offset_m: tuple[float, float, float] | None,
    turn_deg: float | None,
) -> Trajectory:
    """The trajectory displaced along its own axes and the world's, then turned about its own z."""
    if offset_m is not None:
        offset: FloatArray = np.array(offset_m, float)
        curve = offset_curve(trajectory, trajectory.times_s, lambda times: np.broadcast_to(offset, (len(times), 3)))
        trajectory = displaced(trajectory, curve)
    positions, quaternions = trajectory.positions, trajectory.quaternions_wxyz
    if world_offset_m is not None:
        positions = positions + np.array(world_offset_m, float)
    if turn_deg is not None:
        # a turn on the right passes through slerp, so the keys alone need it
        quaternions = quaternion_product(quaternions, quaternion_from_yaw(np.radians(turn_deg)))
    return Trajectory(trajectory.times_s, positions, quaternions)


def current(drive: Drive, uid: str, place: str, context: Context) -> Actor:
    """The actor as the edits so far leave it. Raises `ScenarioError`, also for one that an earlier edit removed."""
    if uid not in drive.actors:
        for index, edit in enumerate(context.scenario.edits):
            if isinstance(edit, Remove) and edit.actor == uid and uid in context.recorded.actors:
                fail(place, f'"{uid}" was removed by edits[{index}]')
    actor = actor_of(drive.actors, uid, place, "in the log")
    if actor.is_ego_body:
        fail(place, f'"{uid}" is an ego body: it rides on the ego vehicle and takes no other edit')
    return actor


def check_new(drive: Drive, uid: str, place: str, context: Context) -> None:
    """Raise `ScenarioError` where an actor has the id already."""
    if uid in context.recorded.actors:
        fail(f"{place}.id", f'"{uid}" is an actor of the log already')
    if uid in drive.actors:
        fail(f"{place}.id", f'"{uid}" is an actor already')


def _with(drive: Drive, actor: Actor) -> Drive:
    return replace(drive, actors={**drive.actors, actor.uid: actor})


def _time_map(edit: Retime, place: str, context: Context) -> TimeMap:
    if edit.map is not None:
        for index, pair in enumerate(edit.map):
            for time in pair:
                context.check_time(time, f"{place}.map[{index}]")
        scenario, recorded = np.array(edit.map, float).T
        return TimeMap(scenario, recorded)
    first = min(context.recorded.time_s.values())
    pivot = first if edit.pivot_s is None else context.check_time(edit.pivot_s, f"{place}.pivot_s")
    return TimeMap(np.array([pivot + (edit.offset_s or 0.0)]), np.array([pivot]), float(edit.speed or 1.0))
