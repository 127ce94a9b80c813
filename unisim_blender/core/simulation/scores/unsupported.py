"""How much of what the driver looked at nobody recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
