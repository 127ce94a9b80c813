"""How certain a track is: the probability that it is an actor, by what its sweeps show, of a logistic model.

`benchmarks/certainty.py` fits the coefficients to tracks of labelled logs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry import FloatArray
from ..poses.sweeps import import_scipy
from .register import ActorReturns

NEAR_M = 0.3
"""A return lies where something stands within this distance of a voxel that stays."""
STAYS_S = 1.5
"""What is seen for this long at one place stays there."""
FEATURES = {
    "moving": ("part of sweeps", "log returns", "seen", "stands", "low"),
    "standing": ("inside", "leans", "area", "top", "off sides", "around"),
}
COEFFICIENTS = {
    "moving": np.array([
        (0.281, 1, 2.62),  # part of sweeps
        (1.52, 4.79, 0.885),  # log returns
        (0.121, 1.21, 1.43),  # seen
        (0, 1, -2.38),  # stands
        (0.285, 2.25, -0.536),  # low
        (1, 1, -5.38),  # constant
    ]),
    "standing": np.array([
        (0, 0.642, 1.62),  # inside
        (0, 1, 0.437),  # leans
        (0.00316, 0.947, 3.72),  # area
        (0.053, 0.786, -0.897),  # top
        (0.00286, 0.535, -2.74),  # off sides
        (-6.61, 0.474, -0.313),  # around
        (1, 1, -3.38),  # constant
    ]),
}  # fmt: skip
"""Of each feature and of a constant: the lowest and the highest value that counts, and the weight."""


def moving_features(returns: ActorReturns, part: float, seen: float, stays: FloatArray) -> tuple[float, ...]:
    """Return what sweeps show of a moving track: the ``part`` of its time's sweeps in which it is, returns of each,
    ``seen`` of `Shape`, the part of its returns that lie where something stands (``stays``: `StandingMap.voxels`), and
    the height above the ground of the lowest."""
    tree = import_scipy("to find tracks,").cKDTree(stays[stays[:, 7] - stays[:, 6] > STAYS_S, 1:4])
    stands = np.isfinite(tree.query(returns.points, distance_upper_bound=NEAR_M)[0]).mean() if tree.n else 0.0
    each, low = len(returns.points) / len(np.unique(returns.sweep)), np.quantile(returns.points[:, 2], 0.05)
    return (part, float(np.log(each)), seen, float(stands), float(low))


def probability(features: Sequence[float], kind: str) -> float:
    """Return the probability that a track of `FEATURES` of a kind is an actor."""
    low, high, weight = COEFFICIENTS[kind].T
    return float(1 / (1 + np.exp(-np.clip([*features, 1.0], low, high) @ weight)))
