"""Time to collision: how long until the ego meets an actor if both keep their velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import BoolArray, FloatArray
from .collision import BEHIND_RAD, NO_ACTOR, Collisions, angle_from
from .footprints import meeting_times, velocities
from .record import Record

WINDOW_S = 1.0
"""PDM's window: no collision within it may be foreseen (NAVSIM, `PDMScorer`)."""
STANDS_M_S = 5e-3
"""At most this fast, the ego stands and foresees none (NAVSIM, `stopped_speed_threshold`)."""
LEFT_OUT = "lanes_and_intersections_in_time_to_collision"
"""NAVSIM lets actors count that are ahead, and all that are not behind where the map says that lanes meet."""


@dataclass(frozen=True)
class TimeToCollision:
    """The least time to collision over all steps, of the actors that count: ``minimum_s``, at ``minimum_at_s``, with
    ``actor``.

    ``minimum_of_all_s`` is that over all actors, those behind the ego and a standing ego too. ``within_bound``: it
    never is below PDM's window; ``below_bound_at_s`` is the first step where it is, with ``below_bound_actor``. What
    is None has a ``reason``.
    """

    minimum_s: float | None = None
    minimum_at_s: float | None = None
    actor: str | None = None
    minimum_of_all_s: float | None = None
    within_bound: bool | None = None
    below_bound_at_s: float | None = None
    below_bound_actor: str | None = None
    reason: str | None = None


def times_to_collision(record: Record) -> FloatArray:
    """Times to collision (T, A), seconds, of the ego with each actor at each step; 0 where the boxes overlap, inf
    where they do not meet.

    Constant velocity along the headings, turned boxes that keep their headings: exact, by `meeting_times`. (nuPlan
    and NAVSIM move the boxes on in steps of 0.2 or 0.3 s instead.)
    """
    tracks = record.tracks
    ego_velocity = velocities(record.ego_axle[:, 2], record.ego_speeds)
    relative = velocities(tracks.boxes[..., 4], tracks.speeds_m_s) - ego_velocity[:, None]
    begin_s, end_s = meeting_times(record.ego_boxes[:, None], tracks.boxes, relative)
    return np.where(tracks.present & (end_s >= 0), np.maximum(begin_s, 0.0), np.inf)


def actors_that_count(record: Record, found: Collisions) -> BoolArray:
    """Which actors (T, A) the ego must keep its time to collision to, as in NAVSIM: not while the ego stands, none
    behind it, and none after a collision that was not the ego's fault.

    NAVSIM asks the map whether lanes meet, and else lets actors within 30 degrees ahead count alone. There is no map:
    all that are not behind count.
    """
    tracks = record.tracks
    count = tracks.present & (record.ego_speeds > STANDS_M_S)[:, None]
    count &= angle_from(record.ego_axle[:, None], tracks.boxes[..., :2]) <= BEHIND_RAD
    for contact in found.contacts or ():
        if not contact.at_fault:
            count[record.times_s >= contact.time_s, tracks.uids.index(contact.actor)] = False
    return count


def time_to_collision(record: Record, found: Collisions) -> TimeToCollision:
    """The least time to collision of a rollout with these collisions, and whether it kept to PDM's window."""
    if not record.tracks.present.any():
        return TimeToCollision(reason=NO_ACTOR)
    times_s = times_to_collision(record)
    of_all = float(times_s.min())
    counted = np.where(actors_that_count(record, found), times_s, np.inf)
    least_each = counted.min(1)
    below = np.flatnonzero(least_each < WINDOW_S)
    step, actor = np.unravel_index(int(counted.argmin()), counted.shape)
    met = bool(np.isfinite(counted[step, actor]))
    return TimeToCollision(
        minimum_s=float(counted[step, actor]) if met else None,
        minimum_at_s=float(record.times_s[step]) if met else None,
        actor=record.tracks.uids[actor] if met else None,
        minimum_of_all_s=of_all if np.isfinite(of_all) else None,
        within_bound=not len(below),
        below_bound_at_s=float(record.times_s[below[0]]) if len(below) else None,
        below_bound_actor=record.tracks.uids[int(counted[below[0]].argmin())] if len(below) else None,
        reason=None if met else "no actor was on a collision course that the ego has to answer for",
    )
