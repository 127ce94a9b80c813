"""Boxes as annotators see them in a sweep: each where it was as the LiDAR's beams passed it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...geometry import FloatArray
from ...world.drive import Actor, Drive, Lidar
from .box_tracks import passing_times

ROUNDS = 3
"""Where an actor is depends on when it is passed; a round is enough but for the fastest."""


def box_poses(drive: Drive, lidar: Lidar, frame: int) -> tuple[list[Actor], FloatArray]:
    """Return the actors that a frame's labels list, those present when the beams of the frame's sweep pass them, and their poses
    (N, 4, 4) in the world then."""
    every = drive.labelled_actors
    passed = passing(every, lidar, lidar.time_s[frame])
    there = [at for at, actor in enumerate(every) if actor.present(passed[at])]
    actors, times = [every[at] for at in there], passed[there]
    poses = [actor.world_from_actor.at(time) for actor, time in zip(actors, times, strict=True)]
    return actors, np.array(poses).reshape(-1, 4, 4)


def passing(actors: Sequence[Actor], lidar: Lidar, frame_time_s: float) -> FloatArray:
    """Return when the beams of the sweep at a frame's time pass each actor (N,)."""
    times = np.full(len(actors), frame_time_s)
    if not len(actors):
        return times
    for _ in range(ROUNDS):
        places = [actor.world_from_actor.positions_at(time) for actor, time in zip(actors, times, strict=True)]
        times = passing_times(lidar, np.array(places), np.full(len(actors), frame_time_s))
    return times
