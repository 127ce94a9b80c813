"""Scores made of scores: NAVSIM's PDMS without what it asks of a map, AlpaSim's score of a rollout, and HUGSIM's HD-score.

The HD-score is how safe and comfortable the plans were, times how far the vehicle got.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...geometry import BoolArray, FloatArray
from ..footprints import between, overlap, radii, shorter_arc
from .collision import NO_ACTOR, SIDE_COLLISION_RULE, TTC_RULE, Collisions, TimeToCollision
from .driving import Comfort, RouteProgress, is_comfortable
from .off_road import OffRoad, StaticCollision
from .record import PlanRecord, Record

PDMS_LEFT_OUT = ("drivable_area_compliance", "driving_direction_compliance", SIDE_COLLISION_RULE, TTC_RULE)
FULL_PROGRESS = 0.8
"""AlpaSim's: so much of the recorded distance is all that is asked for."""


@dataclass(frozen=True)
class BrokenTerm:
    """A ``term`` of a score whose ``value`` is below 1: the first moment ``at_s`` at which it was broken, and ``by`` which actor
    or quantity; None for a term of the whole drive."""

    term: str
    value: float
    at_s: float | None = None
    by: str | None = None


@dataclass(frozen=True)
class CompositeScore:
    """``score``, 0 to 1, of the ``terms``; ``broken``: what took something off it; ``left_out``: the terms and rules of the
    original that are missing here, as if they were kept. What is None has a ``reason``."""

    score: float | None = None
    terms: dict[str, float | None] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    broken: tuple[BrokenTerm, ...] = ()
    reason: str | None = None


def pdms(collisions: Collisions, times: TimeToCollision, comfort: Comfort, progress: RouteProgress) -> CompositeScore:
    """NC (5 EP + 5 TTC + 2 C) / 12 (Dauner et al., "NAVSIM", NeurIPS 2024, `PDMScorer`), its factor DAC left out.

    NC: no collision at fault; EP: progress, here over the log's and not over the best proposal's; TTC: time to
    collision within the bound; C: comfort.
    """
    within, smooth = times.within_bound, comfort.comfortable
    terms = {
        "no_at_fault_collision": collisions.no_at_fault_collision,
        "ego_progress": progress.share,
        "time_to_collision_within_bound": None if within is None else float(within),
        "comfort": None if smooth is None else float(smooth),
    }
    reasons = dict(zip(terms, (collisions.reason, progress.reason, times.reason, comfort.reason), strict=True))
    faults = collisions.at_fault or ()
    exceeded = [
        (measured.exceeded_at_s, name)
        for name, measured in (comfort.ranges or {}).items()
        if measured.exceeded_at_s is not None
    ]
    moments: dict[str, tuple[float | None, str | None]] = {
        "no_at_fault_collision": (faults[0].time_s, faults[0].actor) if faults else (None, None),
        "time_to_collision_within_bound": (times.below_bound_at_s, times.below_bound_actor),
        "comfort": min(exceeded, default=(None, None)),
    }
    score = _composite(
        terms, reasons, PDMS_LEFT_OUT, lambda nc, ep, in_time, c: nc * (5 * ep + 5 * in_time + 2 * c) / 12
    )
    return replace(score, broken=broken_terms(terms, moments))


def alpasim_score(
    collisions: Collisions, off_road: OffRoad, progress: RouteProgress, static: StaticCollision
) -> CompositeScore:
    """AlpaSim's score of a rollout (`scene_score`): 0 for a collision at fault or a departure from the road, else the
    share of the recorded distance over 0.8, at most 1.

    A collision with the static scene counts as one at fault where it was looked for; where it was not, it is named as
    left out.
    """
    hit = static.collided and not static.at_start
    fault = collisions.at_fault
    terms = {
        "no_at_fault_collision": None if fault is None else float(not fault and not hit),
        "on_road": float(not off_road.off_road),
        "ego_progress": progress.share,
    }
    reasons = dict(zip(terms, (collisions.reason, None, progress.reason), strict=True))
    lacks = {"road_map": off_road.method != "road_labels", "static_collision": static.collided is None}
    left_out = tuple(name for name, is_missing in lacks.items() if is_missing)
    hits = [(contact.time_s, contact.actor) for contact in fault or ()] + (
        [(static.first_s, "the static scene")] if hit else []
    )
    moments: dict[str, tuple[float | None, str | None]] = {
        "no_at_fault_collision": min(hits, default=(None, None)),
        "on_road": (off_road.first_s, None),
    }
    score = _composite(terms, reasons, left_out, lambda nc, road, ep: nc * road * min(ep / FULL_PROGRESS, 1.0))
    return replace(score, broken=broken_terms(terms, moments))


def broken_terms(
    terms: Mapping[str, float | None], moments: Mapping[str, tuple[float | None, str | None]]
) -> tuple[BrokenTerm, ...]:
    """Return the terms that are below 1, in their order, with the first moment and what was met then, where there are such."""
    return tuple(
        BrokenTerm(name, value, *moments.get(name, (None, None)))
        for name, value in terms.items()
        if value is not None and value < 1
    )


def _composite(
    terms: dict[str, float | None],
    reasons: dict[str, str | None],
    left_out: tuple[str, ...],
    formula: Callable[..., float],
) -> CompositeScore:
    """The formula of all terms in their order; no score where one of them is None."""
    missing = [name for name, value in terms.items() if value is None]
    if missing:
        why = "; ".join(f"no {name}: {reasons[name]}" for name in missing)
        return CompositeScore(None, terms, left_out, reason=why)
    return CompositeScore(float(formula(*terms.values())), terms, left_out)


AHEAD_S = (0.5, 1.0)
"""How far each planned position is moved on in search of a collision to come."""
PLANS_PER_BATCH = 32
"""Largest number of plans that are compared with the actors in one batch."""
LEAST_PLAN_M = 1.0
"""A plan that gets less far keeps its first heading: that of positions which hardly move is noise."""
HD_LEFT_OUT = ("drivable_area_compliance", "static_collision")


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
    left_out: tuple[str, ...] = HD_LEFT_OUT
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
        term
        for first in range(0, len(plans), PLANS_PER_BATCH)
        for term in _terms(record, plans[first : first + PLANS_PER_BATCH])
    ]
    if not terms:
        return HdScore(reason="no plan was made within the rollout with two times to come")
    safe, timely, smooth = np.array(terms, np.float64).T
    mean = float((safe * (5 * timely + 2 * smooth) / 7).mean())
    means = (float(safe.mean()), float(timely.mean()), float(smooth.mean()))
    moments: dict[str, tuple[float | None, str | None]] = {}
    for name, passed in zip(("no_collision", "time_to_collision", "comfort"), (safe, timely, smooth), strict=True):
        if not passed.all():
            moments[name] = (plans[int(passed.argmin())].planned_us / 1e6, "the plan made then")
    values = dict(zip(("no_collision", "time_to_collision", "comfort"), means, strict=True))
    broken = broken_terms({**values, "route_completion": route_completion}, moments)
    return HdScore(mean * route_completion, mean, route_completion, *means, plans=len(terms), broken=broken)


def _scored(record: Record, plan: PlanRecord) -> bool:
    within = record.times_us[0] <= plan.planned_us <= record.times_us[-1]
    return bool(within and (plan.times_us > plan.planned_us).sum() >= 2)


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
    to_come = plan.times_us > plan.planned_us
    times_s = np.concatenate([[plan.planned_us], plan.times_us[to_come]]) / 1e6
    step = int(np.searchsorted(record.times_us, plan.planned_us, side="right")) - 1
    later = min(step + 1, len(record.times_us) - 1)
    span = record.times_us[later] - record.times_us[step]
    part = (plan.planned_us - record.times_us[step]) / span if span else 0.0
    start = record.ego_axle[step] + part * (record.ego_axle[later] - record.ego_axle[step])
    start[2] = record.ego_axle[step, 2] + part * shorter_arc(record.ego_axle[later, 2] - record.ego_axle[step, 2])
    axle = np.concatenate([start[None], plan.poses[to_come]])
    if np.hypot(*(axle[-1, :2] - axle[0, :2])) < LEAST_PLAN_M:
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
    """Return the rates that comfort limits, from speeds (K - 1,) between times (K,), K >= 3, and headings (K,) at them:
    plain differences, as `comfort.rates`, but the longitudinal acceleration, which is at the inner times (K - 2), and
    its jerk (K - 3)."""
    duration = np.diff(times_s)
    spacing = (duration[1:] + duration[:-1]) / 2
    yaw_rate = np.diff(np.unwrap(headings)) / duration
    longitudinal = np.diff(speeds) / spacing
    lateral = speeds * yaw_rate
    rates = {
        "longitudinal_acceleration_m_s2": longitudinal,
        "lateral_acceleration_m_s2": lateral,
        "yaw_rate_rad_s": yaw_rate,
        "yaw_acceleration_rad_s2": np.diff(yaw_rate) / spacing,
    }
    if len(longitudinal) > 1:
        between_s = np.diff(times_s[1:-1])
        rates["longitudinal_jerk_m_s3"] = np.diff(longitudinal) / between_s
        rates["jerk_m_s3"] = np.diff(np.hypot(longitudinal, (lateral[1:] + lateral[:-1]) / 2)) / between_s
    return rates
