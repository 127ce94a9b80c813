"""Poses of an actor by registration of its returns in all sweeps, with a motion that keeps its velocity and turn rate.

Points of each sweep are matched to planes of sweeps that follow at growing lags, and all poses are solved for
together (as `poses.refine` does for the ego), with accelerations and turn accelerations as residuals: the maximum a
posteriori of a smoother of constant velocity and turn rate, forward and backward in time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..poses.sweeps import import_scipy
from .clusters import Cluster

REACHES_M = (1.5, 1.0, 0.8, 0.6, 0.5, 0.4, 0.3)
MOST_RETURNS = 120
"""Largest number of returns of a sweep that are matched."""
NEIGHBOURS = 8
PLANE_M = 0.7
"""Largest distance of returns that are of one plane."""
LAGS = (1, 2, 4, 8, 16)
"""Sweeps that are matched are this many sweeps apart."""
APART_M = 1e4
NOISE_M = 0.06
HEIGHT = 0.4
"""Heights count this much where the nearest returns are looked for: rows of a sweep lie apart."""
INDEPENDENT = 0.05
"""Number of matches that tell something of their own: neighbours share their errors."""
ACCELERATION, TURN_ACCELERATION = 2.0, 0.6
"""Standard deviations, m/s² and rad/s²."""
PLACE_M = 1.0
"""Standard deviation of where a sweep's returns show the actor before they are registered, metres."""
AHEAD_RAD = np.radians(2.0)
"""Standard deviation of the angle between the heading and the way, at `FAST` and more."""
FAST, SLOW = 3.0, 0.8
"""Speeds, m/s: from the slow one on, the way tells the heading."""
REAR = -0.28
"""Where a vehicle goes the way that it looks, as a part of its length from its middle: its rear axle."""


@dataclass(frozen=True)
class PlanarPath:
    """Positions (K, 2), metres, and headings (K,), radians, of an actor at times (K,), seconds."""

    times_s: FloatArray
    positions: FloatArray
    yaw_rad: FloatArray

    @property
    def velocity(self) -> FloatArray:
        """Velocities (K, 2), m/s."""
        return gradient(self.times_s, self.positions)

    @property
    def speed(self) -> FloatArray:
        """Speeds (K,), m/s."""
        return np.asarray(np.linalg.norm(self.velocity, axis=1))

    def shifted(self, offset: FloatArray) -> PlanarPath:
        """Return the path of the point ``offset`` (2,) of the actor's frame."""
        return replace(self, positions=self.positions + rotated(self.yaw_rad, offset))


def gradient(times_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return derivatives (K, ...) of values (K, ...) at times (K,); 0 of a single one."""
    return np.gradient(values, times_s, axis=0) if len(times_s) > 1 else np.zeros_like(values)


def rotated(yaw_rad: FloatArray, xy: FloatArray) -> FloatArray:
    """Return vectors (..., 2) turned by angles (...)."""
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([cosine * xy[..., 0] - sine * xy[..., 1], sine * xy[..., 0] + cosine * xy[..., 1]], -1)


@dataclass(frozen=True)
class ActorReturns:
    """Returns of an actor in K sweeps: points (N, 3) with heights above the ground, how long after their sweep's time
    they are (N,), and the number of their sweep (N,)."""

    points: FloatArray
    later_s: FloatArray
    sweep: NDArray[np.int64]

    def in_actor(self, path: PlanarPath) -> FloatArray:
        """Return the points (N, 3) in the actor's frame, with the actor's motion within a sweep undone."""
        at = self.sweep
        away = self.points[:, :2] - path.positions[at] - path.velocity[at] * self.later_s[:, None]
        return np.concatenate([rotated(-path.yaw_rad[at], away), self.points[:, 2:]], 1)


def returns_of(clusters: Sequence[Cluster], ground: Callable[[FloatArray], FloatArray]) -> ActorReturns:
    """Return an actor's returns, at most `MOST_RETURNS` of each sweep. ``ground``: heights (N,) below points (N, 3)."""
    chosen = [
        np.unique(np.linspace(0, len(cluster.points) - 1, min(len(cluster.points), MOST_RETURNS)).astype(int))
        for cluster in clusters
    ]
    points = np.concatenate([cluster.points[at] for cluster, at in zip(clusters, chosen, strict=True)])
    later = [cluster.time_s[at] - cluster.middle_s for cluster, at in zip(clusters, chosen, strict=True)]
    height = points[:, 2] - ground(points)
    sweep = np.repeat(np.arange(len(clusters)), [len(at) for at in chosen])
    return ActorReturns(np.concatenate([points[:, :2], height[:, None]], 1), np.concatenate(later), sweep)


def smoothed(times_s: FloatArray, positions: FloatArray, yaw_rad: FloatArray, noise_m: float) -> PlanarPath:
    """Return the path of little acceleration along positions (K, 2) that are off by ``noise_m``; ``yaw_rad`` (K,) is
    used where it stands, the way where it moves."""
    path = PlanarPath(times_s, positions, yaw_rad)
    system = _System(len(times_s))
    system.accelerations(path)
    system.places(path.positions - positions, noise_m)
    path = system.solved(path)
    return replace(path, yaw_rad=_headings(path, yaw_rad))


def _headings(path: PlanarPath, standing_rad: FloatArray) -> FloatArray:
    """Return headings (K,) without jumps: of the way where it is fast enough, between and beyond that interpolated, and
    ``standing_rad`` where nothing moves."""
    fast = path.speed > SLOW
    if not fast.any():
        return standing_rad
    way = np.unwrap(np.arctan2(path.velocity[fast, 1], path.velocity[fast, 0]))
    return np.asarray(np.interp(path.times_s, path.times_s[fast], way))


def register(
    returns: ActorReturns, path: PlanarPath, length_m: float = 0.0, reaches_m: Sequence[float] = REACHES_M
) -> PlanarPath:
    """Return the path on which an actor's returns of all sweeps lie on each other, from one that is within a metre.

    ``length_m``: of a vehicle, whose rear axle goes where it looks. Raises `LogError` where scipy is not installed.
    """
    spatial = import_scipy("to find tracks,")
    begin = path.positions
    for reach in reaches_m:
        local = returns.in_actor(path)
        system = _System(len(path.times_s))
        _match(returns, local, path, reach, system, spatial)
        system.accelerations(path)
        system.places(path.positions - begin, PLACE_M)
        system.headings(path, length_m)
        path = system.solved(path)
    return path


def _match(
    returns: ActorReturns, local: FloatArray, path: PlanarPath, reach: float, system: _System, spatial: Any
) -> None:
    """Add distances of an actor's points (N, 3) in its frame to planes of later sweeps."""
    if len(local) <= NEIGHBOURS:
        return
    xy, sweep = local[:, :2], returns.sweep
    # sweeps lie apart in a fourth dimension, so that one tree has the nearest returns of any given sweep
    places = np.column_stack([xy, local[:, 2] * HEIGHT, sweep * APART_M])
    tree = spatial.cKDTree(places)
    distance, near = tree.query(places, NEIGHBOURS, distance_upper_bound=PLANE_M)
    there = np.isfinite(distance)[..., None]
    around = np.where(there, xy[np.where(there[..., 0], near, 0)], 0)
    count = there.sum(1)
    offset = np.where(there, around - (around.sum(1) / count)[:, None], 0)
    width, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset) / count[..., None])
    thick, wide = (np.sqrt(np.maximum(width[:, axis], 0)) for axis in (0, 1))
    flatness = np.where(count[:, 0] > 2, 1 - thick / np.maximum(wide, 1e-6), 0)
    pairs = [np.zeros((2, 0), np.int64)]
    for lag in LAGS:
        source = np.flatnonzero(sweep + lag < len(path.times_s))
        distance, target = tree.query(places[source] + (0, 0, 0, lag * APART_M), distance_upper_bound=reach)
        met = np.isfinite(distance)
        pairs.append(np.stack([source[met], target[met]]))
    matched, target = np.concatenate(pairs, 1)
    if not len(matched):
        return
    normal = axes[target, :, 0]
    residual = np.sum(normal * (xy[matched] - xy[target]), 1)
    scale = np.maximum(np.hypot(NOISE_M, thick[target]), 1.4826 * float(np.median(np.abs(residual))))
    weight = INDEPENDENT * flatness[target] / (1 + (residual / scale) ** 2) ** 2
    rows = []
    for at, sign in ((matched, -1.0), (target, 1.0)):
        sweep = returns.sweep[at]
        world = rotated(path.yaw_rad[sweep], normal)
        turn = normal[:, 1] * local[at, 0] - normal[:, 0] * local[at, 1]
        rows.append((sweep, sign * np.concatenate([world, turn[:, None]], 1)))
    system.add(rows, residual, weight / scale**2)


class _System:
    """Normal equations of changes (K, 3) of positions and headings."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.matrix = np.zeros((count, 3, count, 3))
        self.right = np.zeros((count, 3))

    def add(
        self, rows: Sequence[tuple[NDArray[np.int64], FloatArray]], residual: FloatArray, weight: FloatArray
    ) -> None:
        """Add residuals (N,) with weights (N,), and their derivatives (N, 3) by the poses (N,) that they depend on."""
        for a, first in rows:
            np.subtract.at(self.right, a, first * (weight * residual)[:, None])
            for b, second in rows:
                np.add.at(self.matrix.transpose(0, 2, 1, 3), (a, b), np.einsum("n,ni,nj->nij", weight, first, second))

    def places(self, away: FloatArray, noise_m: float) -> None:
        """Add that positions are where they began, from which they are ``away`` (K, 2)."""
        at = np.arange(self.count)
        for axis in (0, 1):
            self.matrix[at, axis, at, axis] += noise_m**-2
            self.right[:, axis] -= away[:, axis] * noise_m**-2

    def accelerations(self, path: PlanarPath) -> None:
        """Add that velocities and turn rates are constant."""
        if self.count < 3:
            return
        steps = np.maximum(np.diff(path.times_s), 1e-3)
        middle = np.arange(1, self.count - 1)
        before, after = steps[:-1], steps[1:]
        scale = 2 / (before + after)
        factors = (
            (middle - 1, scale / before),
            (middle, -scale * (1 / before + 1 / after)),
            (middle + 1, scale / after),
        )
        for axis, values, noise in (
            (0, path.positions[:, 0], ACCELERATION),
            (1, path.positions[:, 1], ACCELERATION),
            (2, path.yaw_rad, TURN_ACCELERATION),
        ):
            unit = np.eye(3)[axis]
            residual = np.sum([factor * values[at] for at, factor in factors], 0)
            # white noise of acceleration: its mean over a step varies less, the longer it is
            weight = (before + after) / 0.2 / noise**2
            self.add([(at, factor[:, None] * unit) for at, factor in factors], residual, weight)

    def headings(self, path: PlanarPath, length_m: float) -> None:
        """Add that a vehicle looks where its rear axle goes."""
        rear = path.shifted(np.array([REAR * length_m, 0.0]))
        way = np.arctan2(rear.velocity[:, 1], rear.velocity[:, 0])
        away = (path.yaw_rad - way + np.pi) % (2 * np.pi) - np.pi
        weight = np.clip((rear.speed - SLOW) / (FAST - SLOW), 0, 1) / AHEAD_RAD**2 / 10
        at = np.arange(self.count)
        self.matrix[at, 2, at, 2] += weight + 1e-4
        self.right[:, 2] -= weight * away

    def solved(self, path: PlanarPath) -> PlanarPath:
        """Return the path with the changes that solve the equations."""
        from scipy.linalg import solve

        size = 3 * self.count
        matrix = self.matrix.reshape(size, size) + np.eye(size) * 1e-6
        change = solve(matrix, self.right.ravel(), assume_a="pos").reshape(-1, 3)
        return replace(path, positions=path.positions + change[:, :2], yaw_rad=path.yaw_rad + change[:, 2])
