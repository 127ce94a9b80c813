"""Actors of a drive that edits change: looked up, checked, put in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..errors import ScenarioError, UnisimError
from ..geometry import FloatArray, Trajectory
from ..meshes.read import mesh_size_m
from ..world.drive import Actor, Drive
from .context import EditContext, actor_of
from .faults import fail
from .motion.trajectories import is_moving


def current(drive: Drive, uid: str, place: str, context: EditContext) -> Actor:
    """The actor as the edits so far leave it. Raises `ScenarioError`, also for one that an earlier edit removed."""
    if uid not in drive.actors:
        for index, edit in enumerate(context.scenario.edits):
            if edit.removes(uid) and uid in context.recorded.actors:
                fail(place, f'"{uid}" was removed by edits[{index}]')
    actor = actor_of(drive.actors, uid, place, "in the log")
    if actor.is_ego_body:
        fail(place, f'"{uid}" is an ego body: it rides on the ego vehicle and takes no other edit')
    return actor


def check_new(drive: Drive, uid: str, place: str, context: EditContext) -> None:
    """Raise `ScenarioError` where an actor has the id already."""
    if uid in context.recorded.actors:
        fail(f"{place}.id", f'"{uid}" is an actor of the log already')
    if uid in drive.actors:
        fail(f"{place}.id", f'"{uid}" is an actor already')


def with_actor(drive: Drive, actor: Actor) -> Drive:
    """The drive with an actor, in place of one with its id."""
    return replace(drive, actors={**drive.actors, actor.uid: actor})


def newcomer(source: Actor, uid: str, trajectory: Trajectory, start_s: float, end_s: float) -> Actor:
    """A new actor with the appearance, class and size of ``source``, present from start_s to end_s."""
    moving = is_moving(trajectory)
    return replace(
        source, uid=uid, world_from_actor=trajectory, start_s=start_s, end_s=end_s, is_moving=moving, inserted=True
    )


def mesh_of(name: str, place: str, context: EditContext) -> tuple[Path, FloatArray]:
    """The file of a mesh that a scenario names, and its extent (3,). Raises `ScenarioError`."""
    path = context.scenario.resolve(name)
    try:
        return path, mesh_size_m(path)
    except UnisimError as fault:
        raise ScenarioError(f"{place}.mesh: {fault}") from fault
