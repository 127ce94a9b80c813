"""Clusters of successive sweeps as tracks: a Kalman filter of constant velocity and the best assignment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..geometry import FloatArray
from .clusters import LEAST_RETURNS, Cluster, merged

FIRST_SPEED = 9.0
"""Standard deviation of the speed of what appears, m/s."""
ACCELERATION = 4.0
NOISE_M = 0.35
"""Standard deviation of a cluster's middle, metres: it wanders as other sides are seen."""
GATE, FAR = 3.0, 1e3
COAST_S = 1.3
"""A track ends where nothing has been seen of it for this long."""
SIZE_WEIGHT = 0.5
FEWEST = 4
"""Fewest clusters of a track."""
STITCH_S, STITCH_M, STITCH_GROWTH, STITCH_SPEED = 4.0, 1.5, 1.0, 4.0
"""Two tracks are one across this gap, where they lie this near and this much more for each second of it, and their
velocities differ by no more."""
OVERLAP_S, OVERLAP_M, OVERLAP_SPEED = 0.15, 2.0, 4.5
"""The same where both have a piece of one thing at the end: for this long, this far apart."""
NARROW_M, AROUND_M = 1.5, 0.2
"""What is smaller is a person's; another's returns begin this much beyond it."""
ENDS = 6
SLACK_M = 0.7
"""What is one thing's is no longer than its longest cluster and this."""
BESIDE_M = 1.2
"""A track goes on with a cluster this near to where its velocity carries it."""


class Chain:
    """Clusters of one thing in order of time, with the filter's state (4,) and covariance (4, 4): x, y, and their speeds."""

    def __init__(self, first: Cluster) -> None:
        self.clusters: list[Cluster] = []
        self.state, self.time_s, self.size_m = np.array([*first.middle, 0.0, 0.0]), first.middle_s, 0.0
        self.covariance: FloatArray = np.diag([NOISE_M**2] * 2 + [FIRST_SPEED**2] * 2)
        self.add(first)

    @property
    def is_known(self) -> bool:
        """Whether it has been seen often enough to be a track."""
        return len(self.clusters) >= FEWEST

    def predict(self, time_s: float) -> None:
        """Carry the state on to ``time_s``."""
        step = time_s - self.time_s
        move = np.eye(4)
        move[:2, 2:] = np.eye(2) * step
        noise = np.kron(np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]]), np.eye(2)) * ACCELERATION**2
        self.state, self.covariance = move @ self.state, move @ self.covariance @ move.T + noise * min(abs(step), 1.0)
        self.time_s = time_s

    def add(self, cluster: Cluster) -> None:
        """Add a cluster at the state's time."""
        gain = self.covariance[:, :2] @ np.linalg.inv(self.covariance[:2, :2] + np.eye(2) * NOISE_M**2)
        self.state = self.state + gain @ (cluster.middle - self.state[:2])
        self.covariance = self.covariance - gain @ self.covariance[:2]
        self.size_m = max(self.size_m, cluster.size_m)
        self.clusters.append(cluster)


def associate(sweeps: Iterable[Sequence[Cluster]]) -> list[list[Cluster]]:
    """Return tracks of at least `FEWEST` clusters, in order of time, from the clusters of sweeps in order of time."""
    from scipy.optimize import linear_sum_assignment

    chains: list[Chain] = []
    weak: list[Cluster] = []
    for every in sweeps:
        weak += [cluster for cluster in every if cluster.is_weak]
        clusters = [cluster for cluster in every if not cluster.is_weak]
        if not clusters:
            continue
        middle_s = float(np.mean([cluster.middle_s for cluster in clusters]))
        active = [chain for chain in chains if middle_s - chain.clusters[-1].middle_s <= COAST_S]
        for chain in active:
            chain.predict(middle_s)
        known = [chain for chain in active if chain.is_known]
        groups = _joined(known, _parted(known, clusters))
        cost = np.array([[_cost(chain, group) for group in groups] for chain in active]).reshape(-1, len(groups))
        pairs = zip(*linear_sum_assignment(np.minimum(cost, FAR)), strict=True)
        taken = {column: active[row] for row, column in pairs if cost[row, column] < FAR}
        for number, group in enumerate(groups):
            if number in taken:
                taken[number].predict(group.middle_s)
                taken[number].add(group)
            else:
                chains.append(Chain(group))
    tracks = sorted((chain.clusters for chain in chains if chain.is_known), key=lambda track: track[0].middle_s)
    return [_prolonged(_prolonged(track, weak, 1), weak, -1) for track in _stitched(tracks)]


def _prolonged(chain: list[Cluster], weak: Sequence[Cluster], side: int) -> list[Cluster]:
    """Return clusters of one thing with the ``weak`` ones where it goes on after (``side`` 1) or before (-1) them."""
    weak = sorted(weak, key=lambda cluster: side * cluster.middle_s)
    size = max(cluster.size_m for cluster in chain)
    for cluster in weak:
        later_s = side * (cluster.middle_s - chain[-1 if side > 0 else 0].middle_s)
        if not 0.02 < later_s < COAST_S:
            continue
        time_s, at, velocity = _line(chain[-ENDS:] if side > 0 else chain[:ENDS])
        away = np.linalg.norm(cluster.middle - at - velocity * (cluster.middle_s - time_s))
        if away < BESIDE_M and cluster.size_m < size + SLACK_M:
            chain = [*chain, cluster] if side > 0 else [cluster, *chain]
    return chain


def _cost(chain: Chain, cluster: Cluster) -> float:
    away = cluster.middle - chain.state[:2]
    spread = chain.covariance[:2, :2] + np.eye(2) * NOISE_M**2
    distance = float(np.sqrt(away @ np.linalg.solve(spread, away)))
    if distance > GATE or np.linalg.norm(away) > 6.0:
        return 2 * FAR
    return distance + SIZE_WEIGHT * abs(np.log((cluster.size_m + 0.5) / (chain.size_m + 0.5)))


def _parted(chains: Sequence[Chain], clusters: Sequence[Cluster]) -> list[Cluster]:
    """Return the clusters, and apart from their surroundings those in which somebody is who has a track."""
    parts = list(clusters)
    for chain in chains:
        if chain.size_m >= NARROW_M:
            continue
        for number, cluster in enumerate(parts):
            own = np.linalg.norm(cluster.points[:, :2] - chain.state[:2], axis=1) < (chain.size_m + AROUND_M) / 2
            if min(own.sum(), (~own).sum()) >= LEAST_RETURNS and cluster.size_m > chain.size_m + SLACK_M:
                parts[number : number + 1] = [
                    replace(cluster, points=cluster.points[some], time_s=cluster.time_s[some]) for some in (own, ~own)
                ]
                break
    return parts


def _joined(chains: Sequence[Chain], clusters: Sequence[Cluster]) -> list[Cluster]:
    """Return the clusters, with those joined that lie in the place of one track."""
    middles = np.array([cluster.middle for cluster in clusters])
    is_free, joined = np.ones(len(clusters), bool), []
    for chain in chains:
        near = np.linalg.norm(middles - chain.state[:2], axis=1) < chain.size_m / 2
        inside = np.flatnonzero(near & is_free)
        if chain.size_m >= NARROW_M and len(inside) > 1:
            whole = merged([clusters[number] for number in inside])
            if whole.size_m < chain.size_m + SLACK_M:
                joined.append(whole)
                is_free[inside] = False
    return joined + [cluster for cluster, free in zip(clusters, is_free, strict=True) if free]


def _line(clusters: Sequence[Cluster]) -> tuple[float, FloatArray, FloatArray]:
    """Return the mean time of clusters, and the position (2,) and velocity (2,) there of the line along their middles."""
    times = np.array([cluster.middle_s for cluster in clusters])
    middles = np.array([cluster.middle for cluster in clusters])
    away = times - times.mean()
    return float(times.mean()), middles.mean(0), away @ (middles - middles.mean(0)) / max(float(away @ away), 1e-6)


def _stitched(chains: list[list[Cluster]]) -> list[list[Cluster]]:
    """Return tracks in order of their begin, with those joined that are one by their velocities across a gap."""
    joined: list[list[Cluster]] = []
    for chain in chains:
        best, where = np.inf, -1
        time_b, at_b, speed_b = _line(chain[:ENDS])
        for number, other in enumerate(joined):
            gap = chain[0].middle_s - other[-1].middle_s
            if not -OVERLAP_S < gap < STITCH_S:
                continue
            time_a, at_a, speed_a = _line(other[-ENDS:])
            middle_s = (chain[0].middle_s + other[-1].middle_s) / 2
            away = float(np.linalg.norm(at_a + speed_a * (middle_s - time_a) - at_b - speed_b * (middle_s - time_b)))
            overlaps = gap <= 0
            limit = OVERLAP_M if overlaps else STITCH_M + STITCH_GROWTH * gap
            most = OVERLAP_SPEED if overlaps else STITCH_SPEED
            if away < min(best, limit) and np.linalg.norm(speed_a - speed_b) < most:
                best, where = away, number
        if where < 0:
            joined.append(chain)
        else:
            joined[where] += [cluster for cluster in chain if cluster.middle_s > joined[where][-1].middle_s]
    return joined
