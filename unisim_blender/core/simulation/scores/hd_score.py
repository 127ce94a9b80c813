"""HUGSIM's HD-score: how safe and comfortable what the driver planned was, times how far it got."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry import BoolArray, FloatArray
from .collision import NO_ACTOR
from .comfort import is_comfortable
from .footprints import between, overlap, radii, shorter_arc
from .pdms import BrokenTerm, broken_terms
from .record import PlanRecord, Record

AHEAD_S = (0.5, 1.0)
"""How far each planned position is moved on in search of a collision to come."""
TOGETHER = 32
"""So many plans are held against the actors at once."""
STANDS_M = 1.0
"""A plan that gets less far keeps its first heading: that of positions which hardly move is noise."""
LEFT_OUT = ("drivable_area_compliance", "static_collision")


@dataclass(frozen=True)
class HdScore:
    """``score``, 0 to 1: ``mean_of_plans`` times ``route_completion``. Means over the ``plans`` that were scored of
    no collision, time to collision and comfort. ``left_out``: HUGSIM's terms that are missing here, as if they were
    1. ``broken``: the terms below 1, each with the time of the first plan that broke it. What is None has a ``reason``."""

    score: float | None = None
    mean_of_plans: float | None = None
    route_completion: float | None = None
    no_collision_mean: float | None = None
    time_to_collision_mean: float | None = None
    comfort_mean: float | None = None
    plans: int = 0
    left_out: tuple[str, ...] = LEFT_OUT
    broken: tuple[BrokenTerm, ...] = ()
    reason: str | None = None


def hd_score(record: Record, route_completion: float | None) -> HdScore:
    """The mean over plans of NC (5 TTC + 2 C) / 7, times the route's completion (Zhou et al., "HUGSIM", 2024,
    `ScoreCalculator`).

    NC is 1 where no planned box overlaps an actor's at the same time, TTC where none does when it is moved on by its
    planned velocity for 0.5 and 1 s, C where the plan is comfortable by PDM's limits; else 0. Actors are where they
    were in the rollout, so what is planned beyond its end counts for comfort alone. HUGSIM's NC and DAC also ask the
    background and the ground; its TTC leaves the actors behind when it moves the ego on, which this does not.
    """
    if not record.plans:
        return HdScore(reason="the driver gave no plans")
    if not record.tracks.present.any():
        return HdScore(reason=NO_ACTOR)
    if route_completion is None:
        return HdScore(reason="the route's completion is not known")
    plans = [plan for plan in record.plans if _scored(record, plan)]
    terms = [
        term for first in range(0, len(plans), TOGETHER) for term in _terms(record, plans[first : first + TOGETHER])
    ]
    if not terms:
        return HdScore(reason="no plan was made within the rollout with two times to come")
    safe, timely, smooth = np.array(terms, np.float64).T
    mean = float((safe * (5 * timely + 2 * smooth) / 7).mean())
    means = (float(safe.mean()), float(timely.mean()), float(smooth.mean()))
    moments: dict[str, tuple[float | None, str | None]] = {}
    for name, kept in zip(("no_collision", "time_to_collision", "comfort"), (safe, timely, smooth), strict=True):
        if not kept.all():
            moments[name] = (plans[int(kept.argmin())].made_us / 1e6, "the plan made then")
    values = dict(zip(("no_collision", "time_to_collision", "comfort"), means, strict=True))
    broken = broken_terms({**values, "route_completion": route_completion}, moments)
    return HdScore(mean * route_completion, mean, route_completion, *means, plans=len(terms), broken=broken)


def _scored(record: Record, plan: PlanRecord) -> bool:
    within = record.times_us[0] <= plan.made_us <= record.times_us[-1]
    return bool(within and (plan.times_us > plan.made_us).sum() >= 2)


def _terms(record: Record, plans: Sequence[PlanRecord]) -> Iterator[tuple[bool, bool, bool]]:
    """No collision, time to collision and comfort of each of some plans."""
    planned = [_planned(record, plan) for plan in plans]
    times, moved = [], []
    for times_s, boxes, velocity in planned:
        for ahead in (0.0, *AHEAD_S):
            times.append(times_s + ahead)
            moved.append(boxes.copy())
            moved[-1][:, :2] += ahead * velocity
    hits = iter(
        np.split(_hits(record, np.concatenate(times), np.concatenate(moved)), np.cumsum([*map(len, times)])[:-1])
    )
    for times_s, boxes, velocity in planned:
        now, *later = (bool(next(hits).any()) for _ in (0.0, *AHEAD_S))
        speeds = np.linalg.norm(velocity, axis=-1)
        smooth = is_comfortable(_planned_rates(times_s, speeds[1:], boxes[:, 4]))
        yield not now, not (now or any(later)), smooth


def _planned(record: Record, plan: PlanRecord) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (K,), the ego's boxes (K, 5) and velocities (K, 2) of a plan, the state it started from first. A velocity
    is that since the time before; the first is the second's."""
    to_come = plan.times_us > plan.made_us
    times_s = np.concatenate([[plan.made_us], plan.times_us[to_come]]) / 1e6
    step = int(np.searchsorted(record.times_us, plan.made_us, side="right")) - 1
    later = min(step + 1, len(record.times_us) - 1)
    span = record.times_us[later] - record.times_us[step]
    part = (plan.made_us - record.times_us[step]) / span if span else 0.0
    start = record.ego_axle[step] + part * (record.ego_axle[later] - record.ego_axle[step])
    start[2] = record.ego_axle[step, 2] + part * shorter_arc(record.ego_axle[later, 2] - record.ego_axle[step, 2])
    axle = np.concatenate([start[None], plan.poses[to_come]])
    if np.hypot(*(axle[-1, :2] - axle[0, :2])) < STANDS_M:
        axle[:, 2] = axle[0, 2]
    velocity = np.diff(axle[:, :2], axis=0) / np.diff(times_s)[:, None]
    # the box is where it is on the vehicle
    x, y, length, width, heading = record.ego_boxes[0]
    base = record.ego_axle[0]
    cosine, sine = np.cos(base[2]), np.sin(base[2])
    ahead = (x - base[0]) * cosine + (y - base[1]) * sine
    aside = (y - base[1]) * cosine - (x - base[0]) * sine
    turned = axle[:, 2] + shorter_arc(heading - base[2])
    cosine, sine = np.cos(axle[:, 2]), np.sin(axle[:, 2])
    boxes = np.stack(
        [
            axle[:, 0] + ahead * cosine - aside * sine,
            axle[:, 1] + ahead * sine + aside * cosine,
            np.full(len(axle), length),
            np.full(len(axle), width),
            turned,
        ],
        -1,
    )
    return times_s, boxes, np.concatenate([velocity[:1], velocity])


def _hits(record: Record, times_s: FloatArray, boxes: FloatArray) -> BoolArray:
    """Which boxes (K, 5) overlap an actor's at their times (K,): (K,). After the rollout none does."""
    tracks, steps = record.tracks, record.times_s
    out = np.zeros(len(times_s), bool)
    within = np.flatnonzero(times_s <= steps[-1] + 1e-9)
    times_s, boxes = times_s[within], boxes[within]
    step = np.searchsorted(steps, times_s + 1e-9, side="right") - 1
    later = np.minimum(step + 1, len(steps) - 1)
    span = np.where(later > step, steps[later] - steps[step], 1.0)
    part = np.clip((times_s - steps[step]) / span, 0.0, 1.0)

    # actors whose positions in that time come near to where the boxes are at all
    time = slice(int(step.min()), int(later.max()) + 1)
    places, reach = tracks.boxes[time, :, :2], (tracks.radii_m + radii(boxes).max())[:, None]
    low, high = boxes[:, :2].min(0) - reach, boxes[:, :2].max(0) + reach
    some = np.flatnonzero(((places.max(0) >= low) & (places.min(0) <= high)).all(-1))
    there, stays = (tracks.present[at[:, None], some] for at in (step, later))
    begin, end = (tracks.boxes[at[:, None], some, :2] for at in (step, later))
    centre = begin + np.where(stays, part[:, None], 0.0)[..., None] * (end - begin)
    near = there & (stays | (part < 1e-6)[:, None])
    near &= ((centre - boxes[:, None, :2]) ** 2).sum(-1) <= (reach[some, 0] + 1e-6) ** 2
    rows, actors = np.nonzero(near)
    ends = np.where(stays[rows, actors], later[rows], step[rows])
    actors = some[actors]
    others = between(tracks.boxes[step[rows], actors], tracks.boxes[ends, actors], part[rows])
    out[within[rows[overlap(boxes[rows], others)]]] = True
    return out


def _planned_rates(times_s: FloatArray, speeds: FloatArray, headings: FloatArray) -> dict[str, FloatArray]:
    """What comfort has limits for, of speeds (K - 1,) between times (K,), K >= 3, and headings (K,) at them: plain
    differences, as `comfort.rates`, but the longitudinal acceleration, which is at the inner times (K - 2), and its
    jerk (K - 3)."""
    duration = np.diff(times_s)
    spacing = (duration[1:] + duration[:-1]) / 2
    yaw_rate = np.diff(np.unwrap(headings)) / duration
    longitudinal = np.diff(speeds) / spacing
    lateral = speeds * yaw_rate
    found = {
        "longitudinal_acceleration_m_s2": longitudinal,
        "lateral_acceleration_m_s2": lateral,
        "yaw_rate_rad_s": yaw_rate,
        "yaw_acceleration_rad_s2": np.diff(yaw_rate) / spacing,
    }
    if len(longitudinal) > 1:
        between_s = np.diff(times_s[1:-1])
        found["longitudinal_jerk_m_s3"] = np.diff(longitudinal) / between_s
        found["jerk_m_s3"] = np.diff(np.hypot(longitudinal, (lateral[1:] + lateral[:-1]) / 2)) / between_s
    return found
