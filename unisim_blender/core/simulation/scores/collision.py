"""Collisions of the ego vehicle with actors: when, how fast, on which side, and whose fault."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...geometry import FloatArray
from .footprints import between, bumper, distances, first_contacts, overlap, shorter_arc, velocities
from .record import Record

STANDS_M_S = 0.05
"""At most this fast, a vehicle stands (nuPlan's threshold, above the noise of tracks)."""
BEHIND_RAD = math.radians(150)
"""Beyond this angle from the ego's heading, seen from its rear axle, an actor is behind (nuPlan's
`is_agent_behind`)."""
BUMPER_M = 0.02
"""So near to a bumper's line the other box meets it: in a turn the time of first contact is that exact
(`first_contacts`)."""
NO_ACTOR = "no other actor was present"
LEFT_OUT = "lanes_in_side_collisions"
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
        return None if self.contacts is None else tuple(one for one in self.contacts if one.at_fault)

    @property
    def no_at_fault_collision(self) -> float | None:
        """PDMS's factor NC: 1 without a collision at fault, 0.5 with objects alone, else 0 (NAVSIM, `PDMScorer`)."""
        if self.at_fault is None:
            return None
        return min((0.5 if one.is_object else 0.0 for one in self.at_fault), default=1.0)


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
