"""How certain a track is: the probability that it is an actor, by what its sweeps show, of a logistic model.

`benchmarks/certainty.py` fits the coefficients to tracks of labelled logs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry import FloatArray
from ..poses.sweeps import import_scipy
from .register import ActorReturns, PlanarPath

NEAR_M = 0.3
"""A return lies where something stands within this distance of a voxel that stays."""
STAYS_S = 1.5
"""What is seen for this long at one place stays there."""
FEATURES = {
    "moving": ("log sweeps", "part of sweeps", "log returns", "support", "seen", "stands", "log displacement", "low"),
    "standing": ("log voxels", "inside", "leans", "length", "width", "top", "end", "off sides", "around"),
}
COEFFICIENTS = {
    "moving": np.array([
        (1.54, 3.69, 0.453),  # log sweeps
        (0.512, 1, -0.68),  # part of sweeps
        (1.65, 4.79, 0.776),  # log returns
        (0.374, 0.997, -0.42),  # support
        (0.088, 1.07, 2.99),  # seen
        (0, 0.308, -2.71),  # stands
        (1.37, 3.62, 0.165),  # log displacement
        (0.288, 2.04, -1.55),  # low
        (1, 1, -2.83),  # constant
    ]),
    "standing": np.array([
        (3.71, 6.91, 0.56),  # log voxels
        (0, 0.591, 1.53),  # inside
        (0, 1, 0.307),  # leans
        (0.00321, 1, 2.66),  # length
        (0.198, 1, 1.27),  # width
        (0.0565, 0.793, -1.77),  # top
        (0, 1, -1.03),  # end
        (0.00246, 0.361, -3.15),  # off sides
        (-6.92, 0.564, -0.169),  # around
        (1, 1, -6.13),  # constant
    ]),
}  # fmt: skip
"""Of each feature and of a constant: the lowest and the highest value that counts, and the weight."""


def moving_features(
    path: PlanarPath,
    returns: ActorReturns,
    local: FloatArray,
    seen: float,
    support: float,
    part: float,
    stays: FloatArray,
) -> tuple[float, ...]:
    """Return what sweeps show of a moving track.

    ``local`` (N, 3): its returns in its frame; ``seen``: see `Shape`; ``support``: part of the returns that other sweeps
    confirm; ``part``: of its time's sweeps in which it is; ``stays``: `StandingMap.voxels`.
    """
    tree = import_scipy("to find tracks,").cKDTree(stays[stays[:, 7] - stays[:, 6] > STAYS_S, 1:4])
    stands = np.isfinite(tree.query(returns.points, distance_upper_bound=NEAR_M)[0]).mean() if tree.n else 0.0
    away = np.linalg.norm(path.positions - path.positions[0], axis=1).max()
    return (
        float(np.log(len(path.times_s))),
        part,
        float(np.log(len(returns.points) / len(path.times_s))),
        support,
        seen,
        float(stands),
        float(np.log(away)),
        float(np.quantile(local[:, 2], 0.05)),
    )


def probability(features: Sequence[float], kind: str) -> float:
    """Return the probability that a track of `FEATURES` of a kind is an actor."""
    low, high, weight = COEFFICIENTS[kind].T
    return float(1 / (1 + np.exp(-np.clip([*features, 1.0], low, high) @ weight)))
