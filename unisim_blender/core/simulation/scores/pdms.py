"""Scores of scores: NAVSIM's PDMS without what it asks of a map, and AlpaSim's score of a rollout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from . import collision, ttc
from .collision import Collisions
from .comfort import Comfort
from .off_road import OffRoad
from .progress import Progress
from .static import StaticCollision
from .ttc import TimeToCollision

LEFT_OUT = ("drivable_area_compliance", "driving_direction_compliance", collision.LEFT_OUT, ttc.LEFT_OUT)
FULL_PROGRESS = 0.8
"""AlpaSim's: so much of the recorded distance is all that is asked for."""


@dataclass(frozen=True)
class Composite:
    """``score``, 0 to 1, of the ``terms``; ``left_out``: the terms and rules of the original that are missing here,
    as if they were kept. What is None has a ``reason``."""

    score: float | None = None
    terms: dict[str, float | None] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    reason: str | None = None


def pdms(collisions: Collisions, times: TimeToCollision, comfort: Comfort, progress: Progress) -> Composite:
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
    return _composite(terms, reasons, LEFT_OUT, lambda nc, ep, in_time, c: nc * (5 * ep + 5 * in_time + 2 * c) / 12)


def alpasim_score(collisions: Collisions, off_road: OffRoad, progress: Progress, static: StaticCollision) -> Composite:
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
    return _composite(terms, reasons, left_out, lambda nc, road, ep: nc * road * min(ep / FULL_PROGRESS, 1.0))


def _composite(
    terms: dict[str, float | None],
    reasons: dict[str, str | None],
    left_out: tuple[str, ...],
    formula: Callable[..., float],
) -> Composite:
    """The formula of all terms in their order; no score where one of them is None."""
    missing = [name for name, value in terms.items() if value is None]
    if missing:
        why = "; ".join(f"no {name}: {reasons[name]}" for name in missing)
        return Composite(None, terms, left_out, why)
    return Composite(float(formula(*terms.values())), terms, left_out)
