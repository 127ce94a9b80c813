"""Functions that rise from 0 to the end of a valid domain, and their inverse: a table, solved once, and Newton's method
in its cells, safeguarded by bisection."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry import BoolArray, FloatArray
from .lens import EDGE, LEAST_SLOPE

NODES = 2049
"""Number of nodes of an inverse's table."""
STEEPEST = 1e6
"""Largest slope of a lens, relative to that on its axis: beyond it the inverse's cells next to 0 are too coarse; no
real lens comes near."""
ITERATIONS = 6
"""Number of Newton steps, fixed so that the result of a value does not depend on the other values of the array."""
BISECTIONS = 60

Function = Callable[[FloatArray], FloatArray]


def end_of_rise(slope: Function, end: float, steepest: float = np.inf) -> float:
    """Return where a function stops to rise on (0, end]: where its slope first falls to `LEAST_SLOPE` of that at 0, or
    grows to ``steepest`` times it, found on a grid and then by bisection; ``end`` where neither happens, 0 where it
    does not begin to rise."""
    at = np.linspace(0.0, end, NODES)
    with np.errstate(all="ignore"):
        slopes = slope(at)
        least = LEAST_SLOPE * slopes[0]
        if not least > 0:
            return 0.0
        most = steepest * slopes[0]
        out = ~((slopes > least) & (slopes < most))
        if not out.any():
            return end
        first = int(out.argmax())
        inside, outside = float(at[first - 1]), float(at[first])
        for _ in range(BISECTIONS):
            middle = (inside + outside) / 2
            if least < slope(np.array([middle]))[0] < most:
                inside = middle
            else:
                outside = middle
    return inside


class Inverse:
    """The inverse of a function that rises on [0, end] from 0."""

    def __init__(self, function: Function, slope: Function, end: float) -> None:
        self.function, self.slope = function, slope
        self.arguments = np.linspace(0.0, end, NODES)
        # rounding must not make the table fall
        self.values = np.maximum.accumulate(function(self.arguments))
        self.most = float(self.values[-1])

    def __call__(self, values: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the arguments (...) of values (...), and where there is one; 0 elsewhere."""
        valid = (values >= 0) & (values <= self.most * EDGE)
        wanted = np.minimum(np.where(valid, values, 0.0), self.most)
        cell = np.clip(np.searchsorted(self.values, wanted, side="right") - 1, 0, NODES - 2)
        low, high = self.arguments[cell], self.arguments[cell + 1]
        below, above = self.values[cell], self.values[cell + 1]
        rise = above - below
        part = np.where(rise > 0, (wanted - below) / np.where(rise > 0, rise, 1.0), 0.0)
        at = low + part * (high - low)
        for _ in range(ITERATIONS):
            miss = self.function(at) - wanted
            low, high = np.where(miss <= 0, at, low), np.where(miss >= 0, at, high)
            slope = self.slope(at)
            to = at - miss / np.where(slope > 0, slope, 1.0)
            at = np.where((slope > 0) & (to >= low) & (to <= high), to, (low + high) / 2)
        return at, valid
