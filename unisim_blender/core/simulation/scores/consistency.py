"""How much a driver changes its mind: distances between successive plans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import FloatArray
from .record import PlanRecord, Record

DECAY_S = 1.0
"""A planned position this much later weighs 1/e as much."""
END_S = 5.0
"""UniSim compares plans by their positions after this time."""


@dataclass(frozen=True)
class PlanConsistency:
    """Over the ``pairs`` of successive plans that share times: mean and greatest distance, near positions weighing
    more; and the mean distance after 5 s, over the ``end_pairs`` that reach so far. What is None has a ``reason``."""

    mean_m: float | None = None
    max_m: float | None = None
    pairs: int = 0
    end_point_mean_m: float | None = None
    end_pairs: int = 0
    reason: str | None = None


def plan_consistency(record: Record) -> PlanConsistency:
    """Distances between successive plans.

    As AlpaSim's plan deviation: the later plan's positions after the time it was made at, up to the earlier plan's
    end, against the earlier plan's at the same times, averaged with weights that decay exponentially. AlpaSim's
    weights decay by the number of the position; these by its time, over `DECAY_S`, so plans of any spacing compare.
    The distance after 5 s is UniSim's plan consistency (Yang et al., CVPR 2023, supplementary 4.5), there between
    plans on real and simulated data.
    """
    if not record.plans:
        return PlanConsistency(reason="the driver gave no plans")
    if len(record.plans) < 2:
        return PlanConsistency(reason="the driver gave one plan alone")
    pairs = list(zip(record.plans, record.plans[1:], strict=False))
    distances = [one for one in (_distance(earlier, later) for earlier, later in pairs) if one is not None]
    ends = [one for one in (_end_distance(earlier, later) for earlier, later in pairs) if one is not None]
    if not distances:
        return PlanConsistency(reason="no two successive plans share a time")
    return PlanConsistency(
        mean_m=float(np.mean(distances)),
        max_m=float(np.max(distances)),
        pairs=len(distances),
        end_point_mean_m=float(np.mean(ends)) if ends else None,
        end_pairs=len(ends),
        reason=None if ends else f"no two successive plans reach {END_S:g} s ahead",
    )


def _distance(earlier: PlanRecord, later: PlanRecord) -> float | None:
    times = later.times_us[(later.times_us > later.made_us) & (later.times_us <= earlier.times_us[-1])]
    times = times[times >= earlier.times_us[0]]
    if not len(times):
        return None
    apart = np.linalg.norm(_positions(later, times / 1e6) - _positions(earlier, times / 1e6), axis=-1)
    weights = np.exp(-(times - later.made_us) / 1e6 / DECAY_S)
    if not weights.sum() > 0:  # all so late that their weights vanish
        return None
    return float((weights * apart).sum() / weights.sum())


def _end_distance(earlier: PlanRecord, later: PlanRecord) -> float | None:
    end_us = later.made_us + round(END_S * 1e6)
    if any(end_us > plan.times_us[-1] or end_us < plan.times_us[0] for plan in (earlier, later)):
        return None
    end_s = np.array([end_us / 1e6])
    return float(np.linalg.norm(_positions(later, end_s) - _positions(earlier, end_s)))


def _positions(plan: PlanRecord, times_s: FloatArray) -> FloatArray:
    """Planned positions (N, 2) at times (N,), linear between the plan's."""
    return np.stack([np.interp(times_s, plan.times_us / 1e6, plan.poses[:, axis]) for axis in (0, 1)], -1)
