"""All scores of a rollout as one document."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from .collision import Collisions, collisions, minimum_distance, ncap_stars, time_to_collision
from .composite import alpasim_score, hd_score, pdms
from .driving import LIMITS, Comfort, comfort, deviation, path_places, plan_consistency, progress
from .off_road import CORRIDOR_M, Occupied, RoadTest, off_road, static_collision
from .record import Record

TOO_MUCH = 0.2
"""From this share of unsupported pixels on, what a rollout shows is more guess than evidence."""


@dataclass(frozen=True)
class Unsupported:
    """Mean and greatest share of unsupported pixels over the steps at which the driver was shown some, and the first
    time at which it is above `TOO_MUCH`; None where it never is. Shares that are None have a ``reason``."""

    mean_share: float | None = None
    max_share: float | None = None
    above_20_percent_at_s: float | None = None
    reason: str | None = None


def unsupported(record: Record) -> Unsupported:
    """How far a rollout is evidence: the shares of unsupported pixels that the driver looked at."""
    shown = [(t, s) for t, s in zip(record.times_s, record.unsupported_share or (), strict=False) if s is not None]
    if not shown:
        return Unsupported(reason="the driver was shown no pixels whose support was measured")
    times_s, shares = np.array(shown, np.float64).T
    above = np.flatnonzero(shares > TOO_MUCH)
    return Unsupported(float(shares.mean()), float(shares.max()), float(times_s[above[0]]) if len(above) else None)


def summarise(
    record: Record,
    *,
    occupied: Occupied | None = None,
    on_road: RoadTest | None = None,
    corridor_width_m: float = CORRIDOR_M,
    reference_speed_m_s: float | None = None,
) -> dict[str, Any]:
    """All scores of a rollout: plain objects, lists, strings and finite numbers, as JSON has them; units are in the
    names.

    Members are always the same. A number that cannot be computed is None, and its object's ``reason`` says why.
    ``occupied``: see `static`; ``on_road`` and ``corridor_width_m``: see `off_road`; ``reference_speed_m_s``: see
    `ncap`. Raises `RecordError` where one of the two functions answers what it may not.
    """
    places = path_places(record)
    crashes, smooth, made = collisions(record), comfort(record), progress(record, places)
    times, road = time_to_collision(record, crashes), off_road(record, on_road, corridor_width_m)
    static = static_collision(record, occupied)
    found: dict[str, Any] = {
        "pdms": pdms(crashes, times, smooth, made),
        "hd_score": hd_score(record, made.share),
        "alpasim_score": alpasim_score(crashes, road, made, static),
        "ncap": ncap_stars(record, crashes, reference_speed_m_s),
        "time_to_collision": times,
        "minimum_distance": minimum_distance(record),
        "static_collision": static,
        "off_road": road,
        "progress": made,
        "deviation": deviation(record, places),
        "plan_consistency": plan_consistency(record),
        "unsupported": unsupported(record),
    }
    head = {
        "steps": len(record.times_us),
        "start_s": float(record.times_s[0]),
        "duration_s": float(record.times_s[-1] - record.times_s[0]),
        "actors": len(record.tracks.uids),
    }
    scores = {name: plain(asdict(one)) for name, one in found.items()}
    return head | {"collision": _collision(crashes), "comfort": _comfort(smooth)} | scores


def plain(value: Any) -> Any:
    """The same with lists for tuples, as it reads back from JSON."""
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return value


def _collision(found: Collisions) -> dict[str, Any]:
    contacts, at_fault = found.contacts, found.at_fault
    return {
        "count": None if contacts is None else len(contacts),
        "at_fault_count": None if at_fault is None else len(at_fault),
        "first_s": contacts[0].time_s if contacts else None,
        "no_at_fault_collision": found.no_at_fault_collision,
        "contacts": [asdict(one) for one in contacts or ()],
        "reason": found.reason,
    }


def _comfort(found: Comfort) -> dict[str, Any]:
    ranges = {}
    for name, (lowest, highest) in LIMITS.items():
        one = found.ranges and found.ranges[name]
        ranges[name] = {
            "least": one.least if one else None,
            "greatest": one.greatest if one else None,
            "lower_limit": lowest,
            "upper_limit": highest,
            "within": one.within if one else None,
        }
    return {"comfortable": found.comfortable, **ranges, "reason": found.reason}
