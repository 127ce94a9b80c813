"""Safety of a drive: collisions of the ego vehicle with actors, the time to one, and NeuroNCAP's stars.

A collision says when, how fast, on which side, and whose fault. The time to collision is how long until the ego meets an
actor if both keep their velocities. The stars say how much of a crash the driver avoided.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...geometry import BoolArray, FloatArray
from ..footprints import between, bumper, distances, first_contacts, meeting_times, overlap, shorter_arc, velocities
from .record import Record

STANDS_M_S = 0.05
"""At most this fast, a vehicle stands (nuPlan's threshold, above the noise of tracks)."""
BEHIND_RAD = math.radians(150)
"""Beyond this angle from the ego's heading, seen from its rear axle, an actor is behind (nuPlan's
`is_agent_behind`)."""
BUMPER_M = 0.02
"""Distance from a bumper's line within which the other box meets it: in a turn the time of first contact is that exact
(`first_contacts`)."""
NO_ACTOR = "no other actor was present"
SIDE_COLLISION_RULE = "lanes_in_side_collisions"
"""nuPlan's rule on side collisions asks the map for lanes."""


@dataclass(frozen=True)
class Contact:
    """The first contact of the ego with an actor.

    ``relative_speed_m_s``: the length of the difference of the two velocities. ``side`` of the ego: "front", "rear"
    or "side". ``kind``: nuPlan's, see `contacts`. ``at_start``: the boxes overlapped when the rollout began, which is
    nobody's fault. ``is_object``: the actor is no road user but a thing that stands where it is.
    """

    actor: str
    label: str
    time_s: float
    relative_speed_m_s: float
    ego_speed_m_s: float
    side: str
    kind: str
    at_fault: bool
    at_start: bool
    is_object: bool


@dataclass(frozen=True)
class Collisions:
    """Contacts in the order of time; None, with a reason, where there was no actor to collide with."""

    contacts: tuple[Contact, ...] | None
    reason: str | None = None

    @property
    def at_fault(self) -> tuple[Contact, ...] | None:
        """Those that the ego is to blame for."""
        return None if self.contacts is None else tuple(contact for contact in self.contacts if contact.at_fault)

    @property
    def no_at_fault_collision(self) -> float | None:
        """PDMS's factor NC: 1 without a collision at fault, 0.5 with objects alone, else 0 (NAVSIM, `PDMScorer`)."""
        if self.at_fault is None:
            return None
        return min((0.5 if contact.is_object else 0.0 for contact in self.at_fault), default=1.0)


@dataclass(frozen=True)
class MinimumDistance:
    """The least distance, over the steps, between the ego's box and an actor's, seen from above; 0 where they overlap:
    ``minimum_m``, at ``minimum_at_s``, from ``actor``. What is None has a ``reason``."""

    minimum_m: float | None = None
    minimum_at_s: float | None = None
    actor: str | None = None
    reason: str | None = None


def minimum_distance(record: Record) -> MinimumDistance:
    """The least distance of a rollout from any actor that was present, with the first step that has it."""
    tracks = record.tracks
    if not tracks.present.any():
        return MinimumDistance(reason=NO_ACTOR)
    apart = np.full(tracks.present.shape, np.inf)
    for actor in range(len(tracks.uids)):
        there = tracks.present[:, actor]
        apart[there, actor] = distances(record.ego_boxes[there], tracks.boxes[there, actor])
    step, nearest = np.unravel_index(int(apart.argmin()), apart.shape)
    return MinimumDistance(float(apart[step, nearest]), float(record.times_s[step]), tracks.uids[int(nearest)])


def collisions(record: Record) -> Collisions:
    """The ego's collisions with actors. Each actor counts once, as in nuPlan."""
    if not record.tracks.present.any():
        return Collisions(None, NO_ACTOR)
    return Collisions(contacts(record))


def contacts(record: Record) -> tuple[Contact, ...]:
    """The first contact with each actor, in the order of time.

    Side as AlpaSim has it: front where the ego's front bumper's line meets the other box, else rear where its rear
    bumper's does, else side. Kind and fault by nuPlan's rules (`no_ego_at_fault_collisions`, first that fits):
    "stopped_ego" is not the ego's fault, "stopped_actor" is, "active_rear" (the actor's centre is behind the ego's
    rear axle) is not, "active_front" is. What is left is "active_side", where nuPlan asks the map whether the ego was
    in several lanes or off the road. There is no map: it is the ego's fault, as in AlpaSim, unless the rear bumper
    was hit.
    """
    tracks = record.tracks
    times_s = first_contacts(record.times_s, record.ego_boxes, tracks.boxes, tracks.present)
    order = np.argsort(times_s, kind="stable")
    return tuple(_contact(record, int(actor), float(times_s[actor])) for actor in order if np.isfinite(times_s[actor]))


def _contact(record: Record, actor: int, time_s: float) -> Contact:
    tracks = record.tracks
    step = max(int(np.searchsorted(record.times_s, time_s, side="right")) - 1, 0)
    later = min(step + 1, len(record.times_s) - 1)
    if not tracks.present[later, actor]:
        later = step
    duration = record.times_s[later] - record.times_s[step]
    part = (time_s - record.times_s[step]) / duration if duration > 0 else 0.0
    ego = between(record.ego_boxes[step], record.ego_boxes[later], part)
    other = between(tracks.boxes[step, actor], tracks.boxes[later, actor], part)
    speeds = [
        float(values[step] + part * (values[later] - values[step]))
        for values in (record.ego_speeds, tracks.speeds_m_s[:, actor])
    ]
    difference = velocities(ego[4:5], np.array(speeds[:1])) - velocities(other[4:5], np.array(speeds[1:]))
    axle = record.ego_axle[step] + part * (record.ego_axle[later] - record.ego_axle[step])
    side = side_of(ego, other)
    kind = _kind(float(angle_from(np.array([*axle[:2], ego[4]]), other[:2])), speeds[0], speeds[1], side)
    at_start = time_s <= float(record.times_s[0])
    return Contact(
        actor=tracks.uids[actor],
        label=tracks.labels[actor],
        time_s=time_s,
        relative_speed_m_s=float(np.hypot(*difference[0])),
        ego_speed_m_s=speeds[0],
        side=side,
        kind=kind,
        at_fault=not at_start
        and (kind in ("stopped_actor", "active_front") or (kind == "active_side" and side == "side")),
        at_start=at_start,
        is_object=record.is_object(tracks.labels[actor]),
    )


def side_of(ego: FloatArray, other: FloatArray) -> str:
    """Which side of the ego's box (5,) the other box (5,) is at: "front", "rear" or "side"."""
    for name, sign in (("front", 1), ("rear", -1)):
        if overlap(bumper(ego, sign), other, BUMPER_M):
            return name
    return "side"


def angle_from(axle: FloatArray, positions: FloatArray) -> FloatArray:
    """Angles (...), 0 to pi, of positions (..., 2) from the heading of a pose (..., 3), 0 where they coincide."""
    offset = positions - axle[..., :2]
    bearing = np.arctan2(offset[..., 1], offset[..., 0])
    return np.where((offset == 0).all(-1), 0.0, np.abs(shorter_arc(bearing - axle[..., 2])))


def _kind(angle_rad: float, ego_speed: float, actor_speed: float, side: str) -> str:
    if ego_speed <= STANDS_M_S:
        return "stopped_ego"
    if actor_speed <= STANDS_M_S:
        return "stopped_actor"
    if angle_rad > BEHIND_RAD:
        return "active_rear"
    return "active_front" if side == "front" else "active_side"


TTC_WINDOW_S = 1.0
"""PDM's window: no collision within it may be foreseen (NAVSIM, `PDMScorer`)."""
STOPPED_M_S = 5e-3
"""At most this fast, the ego stands and foresees none (NAVSIM, `stopped_speed_threshold`)."""
TTC_RULE = "lanes_and_intersections_in_time_to_collision"
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


def actors_that_count(record: Record, collisions: Collisions) -> BoolArray:
    """Which actors (T, A) the ego must keep its time to collision to, as in NAVSIM: not while the ego stands, none
    behind it, and none after a collision that was not the ego's fault.

    NAVSIM asks the map whether lanes meet, and else lets actors within 30 degrees ahead count alone. There is no map:
    all that are not behind count.
    """
    tracks = record.tracks
    count = tracks.present & (record.ego_speeds > STOPPED_M_S)[:, None]
    count &= angle_from(record.ego_axle[:, None], tracks.boxes[..., :2]) <= BEHIND_RAD
    for contact in collisions.contacts or ():
        if not contact.at_fault:
            count[record.times_s >= contact.time_s, tracks.uids.index(contact.actor)] = False
    return count


def time_to_collision(record: Record, collisions: Collisions) -> TimeToCollision:
    """The least time to collision of a rollout with these collisions, and whether it kept to PDM's window."""
    if not record.tracks.present.any():
        return TimeToCollision(reason=NO_ACTOR)
    times_s = times_to_collision(record)
    of_all = float(times_s.min())
    counted = np.where(actors_that_count(record, collisions), times_s, np.inf)
    least_each = counted.min(1)
    below = np.flatnonzero(least_each < TTC_WINDOW_S)
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


MOST_STARS = 5.0
STARS_OF_COLLISIONS = 4.0


@dataclass(frozen=True)
class Stars:
    """``stars``, 0 to 5; ``impact_speed_m_s`` of the first collision, ``reference_speed_m_s`` of it had nobody acted.
    What is None has a ``reason``."""

    stars: float | None = None
    impact_speed_m_s: float | None = None
    reference_speed_m_s: float | None = None
    reason: str | None = None


def ncap_stars(record: Record, collisions: Collisions, reference_speed_m_s: float | None = None) -> Stars:
    """Stars of a rollout: 5 without a collision, else 4 max(0, 1 - impact speed / reference speed) of the first
    (Ljungbergh et al., "NeuroNCAP", ECCV 2024, and its `Evaluator`). Collisions that the rollout began in do not
    count.

    A scenario that is made for a crash knows its reference speed, the relative speed of the crash had nobody acted.
    Without one it is that of `untouched_speed`; where that is unknown there are no stars for a collision.
    """
    if collisions.contacts is None:
        return Stars(reason=collisions.reason)
    met = [contact for contact in collisions.contacts if not contact.at_start]
    if not met:
        return Stars(MOST_STARS, reference_speed_m_s=reference_speed_m_s)
    first = met[0]
    reference = untouched_speed(record, first) if reference_speed_m_s is None else reference_speed_m_s
    if reference is None:
        why = (
            f"had the ego kept its first velocity, it would not have met actor {first.actor}: no speed to compare with"
        )
        return Stars(None, first.relative_speed_m_s, None, why)
    if reference <= 0:
        return Stars(None, first.relative_speed_m_s, reference, "the reference speed is 0, and there is no share of 0")
    stars = STARS_OF_COLLISIONS * max(0.0, 1 - first.relative_speed_m_s / reference)
    return Stars(stars, first.relative_speed_m_s, reference)


def untouched_speed(record: Record, contact: Contact) -> float | None:
    """The relative speed, m/s, at which the ego would have met a contact's actor, had it kept the velocity of the
    first step; None where it would not have met it. The actor moves as it did."""
    tracks = record.tracks
    actor = tracks.uids.index(contact.actor)
    velocity = velocities(record.ego_axle[:1, 2], record.ego_speeds[:1])[0]
    boxes = np.repeat(record.ego_boxes[:1], len(record.times_s), 0)
    boxes[:, :2] += (record.times_s - record.times_s[0])[:, None] * velocity
    time_s = first_contacts(record.times_s, boxes, tracks.boxes[:, [actor]], tracks.present[:, [actor]])[0]
    if not np.isfinite(time_s):
        return None
    there = tracks.present[:, actor]
    speed, heading = (
        np.interp(time_s, record.times_s[there], values)
        for values in (tracks.speeds_m_s[there, actor], np.unwrap(tracks.boxes[there, actor, 4]))
    )
    return float(np.hypot(*(velocity - velocities(np.asarray(heading), np.asarray(speed)))))
