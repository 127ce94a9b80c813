"""The edit `scale`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...geometry import Vector3
from ...world.drive import Drive
from ..checks import fail, require
from ..context import EditContext, current, with_actor
from ..edit import Edit, register
from ..types import Scenario

SIZE_FACTOR_BOUNDS = 0.1, 10.0
"""Least and largest size along each axis, relative to the appearance's own; both are allowed."""
UNSCALABLE = f"must lie between {SIZE_FACTOR_BOUNDS[0]:g} and {SIZE_FACTOR_BOUNDS[1]:g} along each axis"


def scales(factors: Sequence[float]) -> bool:
    """Return whether an actor can be scaled by these factors along its axes."""
    return all(SIZE_FACTOR_BOUNDS[0] <= factor <= SIZE_FACTOR_BOUNDS[1] for factor in factors)


@register
@dataclass(frozen=True)
class Scale(Edit):
    """The actor's box and field larger or smaller along its own axes (forward, left, up), about its box's centre:
    factors of 0.1 to 10."""

    type = "scale"
    seen_by = "actors"

    actor: str
    factors: Vector3

    def check(self, scenario: Scenario, place: str) -> None:
        require(scales(self.factors), f"{place}.factors", f"{list(self.factors)} {UNSCALABLE}")

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with the actor larger or smaller about its box's centre, after what earlier edits scaled it
        by."""
        actor = current(drive, self.actor, f"{place}.actor", context)
        total = actor.scale[0] * self.factors[0], actor.scale[1] * self.factors[1], actor.scale[2] * self.factors[2]
        if not scales(total):
            sizes = [round(factor, 6) for factor in total]
            fail(f"{place}.factors", f'with the edits before, "{self.actor}" is scaled by {sizes}, which {UNSCALABLE}')
        return with_actor(drive, replace(actor, size_m=actor.appearance_size_m * np.array(total), scale=total))
