"""How far forecasts and plans are from others, along the ground."""

from __future__ import annotations

import numpy as np

from ..geometry import FloatArray

MODES = 6
"""Forecasts of an actor that are compared: its most probable ones."""


def min_ade(modes: FloatArray, probabilities: FloatArray, truth: FloatArray) -> float:
    """Least average displacement error, m: the mean distance (T,) of the best of the `MODES` most probable modes.

    modes (K, T, 2), probabilities (K,), truth (T', 2) with T' <= T: where the truth ends, the comparison does.
    """
    chosen = modes[np.argsort(-probabilities, kind="stable")[:MODES], : len(truth)]
    return float(np.linalg.norm(chosen - truth, axis=-1).mean(-1).min())


def end_point_error(plan: FloatArray, other: FloatArray) -> float:
    """Distance, m, of the last positions of two plans (T, 2) over the same time."""
    return float(np.linalg.norm(plan[-1] - other[-1]))
