"""Scores of scores: NAVSIM's PDMS without what it asks of a map, and AlpaSim's score of a rollout."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from . import collision, ttc
from .collision import Collisions
from .comfort import Comfort
from .off_road import OffRoad
from .progress import RouteProgress
from .static import StaticCollision
from .ttc import TimeToCollision

LEFT_OUT = ("drivable_area_compliance", "driving_direction_compliance", collision.LEFT_OUT, ttc.LEFT_OUT)
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
        (one.exceeded_at_s, name) for name, one in (comfort.ranges or {}).items() if one.exceeded_at_s is not None
    ]
    moments: dict[str, tuple[float | None, str | None]] = {
        "no_at_fault_collision": (faults[0].time_s, faults[0].actor) if faults else (None, None),
        "time_to_collision_within_bound": (times.below_bound_at_s, times.below_bound_actor),
        "comfort": min(exceeded, default=(None, None)),
    }
    found = _composite(terms, reasons, LEFT_OUT, lambda nc, ep, in_time, c: nc * (5 * ep + 5 * in_time + 2 * c) / 12)
    return replace(found, broken=broken_terms(terms, moments))


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
    hits = [(one.time_s, one.actor) for one in fault or ()] + ([(static.first_s, "the static scene")] if hit else [])
    moments: dict[str, tuple[float | None, str | None]] = {
        "no_at_fault_collision": min(hits, default=(None, None)),
        "on_road": (off_road.first_s, None),
    }
    found = _composite(terms, reasons, left_out, lambda nc, road, ep: nc * road * min(ep / FULL_PROGRESS, 1.0))
    return replace(found, broken=broken_terms(terms, moments))


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
