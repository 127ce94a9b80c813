"""A drive carried on before and after its recording: what stands still is there, what moves does what
the scenario says."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ...geometry import Trajectory
from ...world.captures import SECOND_US
from ...world.drive import FRAME_MARGIN_S, Actor, Drive
from ..types import Scenario
from .ranges import actors_outside, ego_outside, recording_us

REACH_S = 1.0
"""Sensors look no earlier and no later than so long beside their captures."""


def carried_outside(drive: Drive, scenario: Scenario, times_us: Iterable[int]) -> Drive:
    """Return the edited drive with all that is there at times (integer microseconds) before and after its recording;
    the drive itself where all lie within.

    Parked actors stay where they stand, as static copies do. Moving ones are gone, stand still or go on at the velocity
    of their end; those whose edit says ``outside`` do what that says. So does the vehicle, with its sensors and its
    body. The recording lasts until `FRAME_MARGIN_S` after its last frame, as its sensors look.
    """
    times, (first_us, last_us) = list(times_us), recording_us(drive)
    if not times or first_us <= min(times) <= max(times) <= last_us:
        return drive
    first_s, last_s = first_us / SECOND_US - FRAME_MARGIN_S, last_us / SECOND_US + FRAME_MARGIN_S
    window = min(min(times) / SECOND_US - REACH_S, first_s), max(max(times) / SECOND_US + REACH_S, last_s)
    told, ends = _own_rules(scenario), _stated_ends(scenario)
    rule, ego_rule = actors_outside(scenario), ego_outside(scenario)

    def carried(actor: Actor) -> Actor:
        trajectory, own = actor.world_from_actor, told.get(actor.uid)
        if own == "absent":
            return actor
        if actor.is_ego_body:
            trajectory = _held(trajectory, first_s, last_s) if ego_rule == "hold" else trajectory
        elif own != "continue" and (not actor.is_moving or (own is None and rule == "hold")):
            trajectory = _held(trajectory, first_s, last_s)
        elif own is None and rule == "absent":
            return replace(actor, start_s=max(actor.start_s, first_s), end_s=min(actor.end_s, last_s))
        start, end = actor.start_s, actor.end_s
        return replace(
            actor,
            world_from_actor=trajectory,
            start_s=window[0] if start <= first_us / SECOND_US else start,
            end_s=window[1] if end >= last_us / SECOND_US and actor.uid not in ends else end,
        )

    drive = replace(drive, actors={uid: carried(actor) for uid, actor in drive.actors.items()})
    if ego_rule != "hold":
        return drive
    return replace(
        drive,
        world_from_ego=_held(drive.world_from_ego, first_s, last_s),
        cameras={
            name: replace(camera, world_from_camera=_held(camera.world_from_camera, first_s, last_s))
            for name, camera in drive.cameras.items()
        },
        lidars={
            name: replace(lidar, world_from_lidar=_held(lidar.world_from_lidar, first_s, last_s))
            for name, lidar in drive.lidars.items()
        },
    )


def _own_rules(scenario: Scenario) -> dict[str, str | None]:
    """Return what the last edit of where an actor is says of it outside its keys, by the actors' ids."""
    told: dict[str, str | None] = {}
    for edit in scenario.edits:
        uid = getattr(edit, "id", None) or getattr(edit, "actor", None)
        if uid is not None and hasattr(edit, "outside"):
            told[uid] = edit.outside
    return told


def _stated_ends(scenario: Scenario) -> set[str]:
    """Return the ids of the actors whose last edit says until when they are there, and what they do outside the recording."""
    stated: dict[str, bool] = {}
    for edit in scenario.edits:
        uid, present = getattr(edit, "id", None) or getattr(edit, "actor", None), getattr(edit, "present", None)
        if uid is not None and hasattr(edit, "outside"):
            stated[uid] = edit.outside is not None and present is not None and present.end_s is not None
    return {uid for uid, is_stated in stated.items() if is_stated}


def _held(trajectory: Trajectory, first_s: float, last_s: float) -> Trajectory:
    """Return a trajectory that stands still before ``first_s`` and after ``last_s``."""
    if len(trajectory.times_s) == 1:
        return trajectory
    inside = trajectory.times_s[(trajectory.times_s > first_s) & (trajectory.times_s < last_s)]
    times = np.array([first_s - 1.0, first_s, *inside, last_s, last_s + 1.0])
    return Trajectory.from_poses(times, trajectory.at(np.clip(times, first_s, last_s)))
