"""Planar registration of an actor's returns: x, y and heading of one sweep against others, or of all sweeps together.

Points are matched to planes, which in a plane are lines, of sweeps at growing lags, and all poses are solved for together
(as `poses.refine` does for the ego), with accelerations and turn accelerations as residuals: the maximum a posteriori of a
smoother of constant velocity and turn rate, forward and backward in time. One sweep has its prediction as prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray, Trajectory, quaternion_from_yaw
from ..poses.sweeps import import_scipy
from .clusters import Cluster

REACHES_M = (1.5, 1.0, 0.8, 0.6, 0.5, 0.4, 0.3)
MOST_RETURNS = 120
"""Largest number of returns of a sweep that are matched."""
NEIGHBOURS = 8
PLANE_M = 0.7
"""Largest distance of returns that are of one plane."""
ALIGN_REACHES_M = (1.0, 0.7, 0.5, 0.4, 0.3)
ACROSS = 0.05
"""Weight of distances along planes where one sweep is aligned: what is beyond the end of a plane holds it."""
ALIGN_EVIDENCE = 6.0
"""Weight of a sweep's matches against its prediction, relative to that of matches of all sweeps."""
LAGS = (1, 2, 4, 8, 16)
"""Sweeps that are matched are this many sweeps apart."""
APART_M = 1e4
PINNED = 1e-4
"""Standard deviation of a pose that stays where it is, metres and radians."""
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

    def trajectory(self, heights: FloatArray) -> Trajectory:
        """Return the trajectory of upright boxes whose centres are at heights (K,) in the world."""
        return Trajectory(self.times_s, np.column_stack([self.positions, heights]), quaternion_from_yaw(self.yaw_rad))


def gradient(times_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return derivatives (K, ...) of values (K, ...) at times (K,); 0 of a single one."""
    return np.gradient(values, times_s, axis=0) if len(times_s) > 1 else np.zeros_like(values)


def rotated(yaw_rad: FloatArray | float, xy: FloatArray) -> FloatArray:
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
    system.prior(np.zeros((len(times_s), 3)), (noise_m, noise_m, np.inf))
    path = _moved(path, system.solution())
    return replace(path, yaw_rad=_headings(path, yaw_rad))


def _headings(path: PlanarPath, standing_rad: FloatArray) -> FloatArray:
    """Return headings (K,) without jumps: of the way where it is fast enough, between and beyond that interpolated, and
    ``standing_rad`` where nothing moves."""
    fast = path.speed > SLOW
    if not fast.any():
        return standing_rad
    way = np.unwrap(np.arctan2(path.velocity[fast, 1], path.velocity[fast, 0]))
    return np.asarray(np.interp(path.times_s, path.times_s[fast], way))


def _moved(path: PlanarPath, change: FloatArray) -> PlanarPath:
    return replace(path, positions=path.positions + change[:, :2], yaw_rad=path.yaw_rad + change[:, 2])


def register(
    returns: ActorReturns,
    path: PlanarPath,
    length_m: float | None = 0.0,
    reaches_m: Sequence[float] = REACHES_M,
    pinned: BoolArray | None = None,
    across: float = 0.0,
) -> PlanarPath:
    """Return the path on which an actor's returns of all sweeps lie on each other, from one that is within a metre.

    ``length_m``: of a vehicle, whose rear axle goes where it looks; None leaves the heading to the returns. Poses that are
    ``pinned`` (K,) stay. ``across``: see `Planes.match`. Raises `LogError` where scipy is not installed.
    """
    import_scipy("to find tracks,")
    begin = np.column_stack([path.positions, path.yaw_rad])
    noise = np.tile([PLACE_M, PLACE_M, np.inf], (len(begin), 1))
    if pinned is not None:
        noise[pinned] = PINNED
    for reach in reaches_m:
        local = returns.in_actor(path)
        system = _System(len(begin))
        _match_sweeps(returns.sweep, local, path, reach, across, system)
        system.accelerations(path)
        system.prior(np.column_stack([path.positions, path.yaw_rad]) - begin, noise)
        if length_m is not None:
            system.headings(path, length_m)
        path = _moved(path, system.solution())
    return path


def align(points: FloatArray, planes: Planes, noise: Sequence[float]) -> FloatArray:
    """Return x, y and heading (3,) of a box, in the frame of its prediction, with which returns (N, 3) of that frame lie on
    planes. ``noise`` (3,): standard deviations of the prediction."""
    pose, sweep, prior = np.zeros(3), np.zeros(len(points), np.int64), np.diag(np.asarray(noise) ** -2.0)
    for reach in ALIGN_REACHES_M:
        local = in_box(points, pose)
        matched, _, direction, residual, weight = planes.match(local, sweep, reach, ACROSS)
        jacobian = -_derivatives(direction, local[matched], pose[2])
        weighted = ALIGN_EVIDENCE * (jacobian * weight[:, None]).T
        pose = pose - np.linalg.solve(weighted @ jacobian + prior, weighted @ residual + prior @ pose)
    return pose


def in_box(points: FloatArray, pose: FloatArray) -> FloatArray:
    """Return points (N, 3) in the frame of a box at x, y and heading, ``pose`` (3,) or (N, 3), in the plane."""
    return np.concatenate([rotated(-pose[..., 2], points[:, :2] - pose[..., :2]), points[:, 2:]], 1)


class Planes:
    """The planes that points (M, 3) of an actor's frame are on with their neighbours of the same sweep (M,)."""

    def __init__(self, points: FloatArray, sweep: NDArray[np.int64]) -> None:
        self.xy = points[:, :2]
        self.tree = import_scipy("to find tracks,").cKDTree(self._places(points, sweep))
        count = min(NEIGHBOURS, len(points))
        distance, near = self.tree.query(self.tree.data, count, distance_upper_bound=PLANE_M)
        distance, near = distance.reshape(-1, count), near.reshape(-1, count)
        there = np.isfinite(distance)[..., None]
        around = np.where(there, self.xy[np.where(there[..., 0], near, 0)], 0)
        number = there.sum(1)
        offset = np.where(there, around - (around.sum(1) / number)[:, None], 0)
        width, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset) / number[..., None])
        self.thick, wide = (np.sqrt(np.maximum(width[:, axis], 0)) for axis in (0, 1))
        self.flatness = np.where(number[:, 0] > 2, 1 - self.thick / np.maximum(wide, 1e-6), 0)
        self.normals = axes[:, :, 0]

    def _places(self, points: FloatArray, sweep: NDArray[np.int64]) -> FloatArray:
        # sweeps lie apart in a fourth dimension, so that one tree has the nearest returns of any given sweep
        return np.column_stack([points[:, :2], points[:, 2] * HEIGHT, sweep * APART_M])

    def match(
        self, points: FloatArray, sweep: NDArray[np.int64], reach: float, across: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, FloatArray, FloatArray]:
        """Return which points (N, 3) are on which planes of sweeps (N,), the directions (P, 2) of their distances, these,
        and their weights (P,). ``across``: weight of distances along the planes, by which their ends count."""
        distance, target = self.tree.query(self._places(points, sweep), distance_upper_bound=reach)
        matched = np.flatnonzero(np.isfinite(distance))
        target = target[matched]
        normals, apart = self.normals[target], points[matched, :2] - self.xy[target]
        residual = np.sum(normals * apart, 1)
        median = float(np.median(np.abs(residual))) if len(residual) else 0.0
        scale = np.maximum(np.hypot(NOISE_M, self.thick[target]), 1.4826 * median)
        weight = INDEPENDENT * self.flatness[target] / (1 + (residual / scale) ** 2) ** 2 / scale**2
        parts = [(matched, target, normals, residual, weight)]
        if across:
            along = normals[:, ::-1] * [1.0, -1.0]
            slide = np.sum(along * apart, 1)
            loose = INDEPENDENT * across / NOISE_M**2 / np.maximum(1.0, np.abs(slide) / NOISE_M)
            parts.append((matched, target, along, slide, loose))
        rows, planes, directions, residuals, weights = (np.concatenate(part) for part in zip(*parts, strict=True))
        return rows, planes, directions, residuals, weights


def _derivatives(normals: FloatArray, local: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return, negative, how distances of points (N, 3) of an actor's frame to planes change with its pose (N, 3)."""
    turn = normals[:, 1] * local[:, 0] - normals[:, 0] * local[:, 1]
    return np.concatenate([rotated(yaw_rad, normals), turn[:, None]], 1)


def _match_sweeps(
    sweep: NDArray[np.int64], local: FloatArray, path: PlanarPath, reach: float, across: float, system: _System
) -> None:
    """Add distances of an actor's points (N, 3) in its frame to planes of later sweeps."""
    if len(local) <= NEIGHBOURS:
        return
    pairs = [(source := np.flatnonzero(sweep + lag < len(path.times_s)), sweep[source] + lag) for lag in LAGS]
    source, other = (np.concatenate(part) for part in zip(*pairs, strict=True))
    planes = Planes(local, sweep)
    matched, target, direction, residual, weight = planes.match(local[source], other, reach, across)
    matched = source[matched]
    rows = []
    for at, sign in ((matched, -1.0), (target, 1.0)):
        derivatives = _derivatives(direction, local[at], path.yaw_rad[sweep[at]])
        rows.append((sweep[at], sign * derivatives))
    system.add(rows, residual, weight)


class _System:
    """Linear equations of changes (K, 3) of positions and headings, in the sense of least squares."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.blocks: list[tuple[NDArray[np.int64], FloatArray, FloatArray, FloatArray]] = []

    def add(
        self, rows: Sequence[tuple[NDArray[np.int64], FloatArray]], residual: FloatArray, weight: FloatArray
    ) -> None:
        """Add residuals (N,) with weights (N,), and their derivatives (N, 3) by the poses (N,) that they depend on."""
        columns = np.concatenate([3 * at[:, None] + np.arange(3) for at, _ in rows], 1)
        self.blocks.append((columns, np.concatenate([derivative for _, derivative in rows], 1), residual, weight))

    def prior(self, away: FloatArray, noise: FloatArray | Sequence[float]) -> None:
        """Add that poses are where they began, from which they are ``away`` (K, 3); ``noise`` (K, 3) or (3,)."""
        weight, at = np.broadcast_to(np.asarray(noise, float) ** -2.0, away.shape), np.arange(self.count)
        for axis, unit in enumerate(np.eye(3)):
            self.add([(at, np.tile(unit, (self.count, 1)))], away[:, axis], weight[:, axis])

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
            residual = np.sum([factor * values[at] for at, factor in factors], 0)
            # white noise of acceleration: its mean over a step varies less, the longer it is
            weight = (before + after) / 0.2 / noise**2
            self.add([(at, factor[:, None] * np.eye(3)[axis]) for at, factor in factors], residual, weight)

    def headings(self, path: PlanarPath, length_m: float) -> None:
        """Add that a vehicle looks where its rear axle goes."""
        rear = path.shifted(np.array([REAR * length_m, 0.0]))
        way = np.arctan2(rear.velocity[:, 1], rear.velocity[:, 0])
        away = (path.yaw_rad - way + np.pi) % (2 * np.pi) - np.pi
        weight = np.clip((rear.speed - SLOW) / (FAST - SLOW), 0, 1) / AHEAD_RAD**2 / 10
        self.add([(np.arange(self.count), np.tile([0.0, 0.0, 1.0], (self.count, 1)))], away, weight + 1e-4)

    def solution(self) -> FloatArray:
        """Return the changes (K, 3) that solve the equations."""
        from scipy.sparse import csr_array, diags_array
        from scipy.sparse.linalg import spsolve

        columns, values, residual, weight = zip(*self.blocks, strict=True)
        ends = np.cumsum([0, *np.concatenate([np.full(len(part), part.shape[1]) for part in columns])])
        entries = (np.concatenate([part.ravel() for part in parts]) for parts in (values, columns))
        jacobian = csr_array((*entries, ends), (len(ends) - 1, 3 * self.count))
        weighted = jacobian.T.multiply(np.concatenate(weight)).tocsr()
        matrix = weighted @ jacobian + diags_array(np.full(3 * self.count, 1e-6))
        return np.asarray(spsolve(matrix.tocsc(), -(weighted @ np.concatenate(residual)))).reshape(-1, 3)
