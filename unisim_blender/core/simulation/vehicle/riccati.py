"""Feedback for a linear system with one input over a finite horizon, by the discrete Riccati iteration.

Minimises the sum over stages of ``(x' - r)^T Q (x' - r) + R (u - w)^2`` with ``x' = A x + B u + g`` (Anderson and Moore,
"Optimal Control: Linear Quadratic Methods", 1990, chapters 2 and 4). The cost-to-go is updated in Joseph's form, which keeps it
symmetric and not negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Stage:
    """One step of a system with n states: a (n, n), b (n,), g (n,); what the state after it should be, r (n,), at the cost
    q (n,), the diagonal of Q; what the input should be, w, at the cost ``cost``."""

    a: FloatArray
    b: FloatArray
    g: FloatArray
    q: FloatArray
    r: FloatArray
    cost: float
    w: float


@dataclass(frozen=True, eq=False)
class Feedback:
    """The best input of a stage: ``-gain @ x - offset``."""

    gain: FloatArray
    offset: float

    def input(self, x: FloatArray) -> float:
        """Return the input for a state (n,)."""
        return float(-self.gain @ x - self.offset)


def feedbacks(stages: Sequence[Stage]) -> list[Feedback]:
    """Return the best input of every stage, from the last one backwards."""
    n = len(stages[-1].b)
    p, linear, found = np.zeros((n, n)), np.zeros(n), []
    for stage in reversed(stages):
        p = p + np.diag(stage.q)
        linear = linear - stage.q * stage.r
        weight = p @ stage.b
        scale = stage.cost + weight @ stage.b
        gain = (weight @ stage.a) / scale
        offset = float((weight @ stage.g + linear @ stage.b - stage.cost * stage.w) / scale)
        found.append(Feedback(gain, offset))
        a, g = stage.a - stage.b[:, None] * gain, stage.g - stage.b * offset
        linear = a.T @ (p @ g + linear) + gain * (stage.cost * (offset + stage.w))
        p = a.T @ p @ a + gain[:, None] * gain * stage.cost
    return found[::-1]
