"""NeuroNCAP's stars: how much of a crash the driver avoided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .collision import Collisions, Contact
from .footprints import first_contacts, velocities
from .record import Record

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
    met = [one for one in collisions.contacts if not one.at_start]
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
