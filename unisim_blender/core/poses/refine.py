"""Refinement of the ego's trajectory: the pose of every sweep such that the planes of all sweeps lie on each other.

Points of a sweep are matched to planes of sweeps before and after it, over lags that grow to the whole drive and where
the drive comes back, and all poses are solved for together (multi-view point-to-plane registration: Chen and Medioni,
1992; Pulli, "Multiview registration for large data sets", 1999). A rolling sweep is undone with the refined motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data.log import PlaneSweep
from ..geometry import (
    FloatArray,
    Trajectory,
    invert_pose,
    make_pose,
    nearest_rotation,
    placed,
    quaternion_from_matrix,
)
from .sweeps import import_scipy

REACHES_M = (2.0, 1.0, 1.0, 0.6, 0.6, 0.4, 0.4, 0.3, 0.3, 0.3)
"""How far apart points are matched to planes, from pass to pass."""
MORE_PASSES = 6
LAGS = (1, 2, 4, 8, 16, 32, 64, 128)
PAIR_M = 60.0
"""Sweeps further apart are not matched."""
POINTS = 1500
"""Points of a sweep that are matched to another."""
LOOP_M = 10.0
"""A sweep is matched to an old one that is as near as this."""
LEAST_MATCHES = 60
GROUND = 0.9
NOISE_M = 0.03
INDEPENDENT = 0.05
"""Share of a pair's points that count as independent: neighbours share errors of planes."""
STEP_M, STEP_RAD = 0.5, 0.02
"""Standard deviation of the change, from sweep to sweep, of the log's error: the prior where sweeps tell nothing."""
PINNED = 1e12
"""Weight with which the correction in the drive's middle stays."""
SPARSE_KEYS = 0.6
"""Corrections are keyed where the log's poses are, if these are at least this many sweeps apart, else at sweeps' middles:
noise of each pose is corrected where it is."""
STANDS_M, STANDS_RAD = 5e-4, 2e-5


@dataclass(frozen=True)
class Refined:
    """A correction of a LiDAR's poses in its own frame, to apply by `corrected`.

    ``std_m``, ``std_rad`` (K,): standard deviations of the correction's keys, relative to that in the drive's middle.
    """

    correction: Trajectory
    std_m: FloatArray
    std_rad: FloatArray


def corrected(recorded: Trajectory, correction: Trajectory) -> Trajectory:
    """Return a sensor's trajectory with a correction in the sensor's own frame: keys are those of both."""
    times = np.union1d(recorded.times_s, correction.times_s)
    within = np.clip(times, correction.times_s[0], correction.times_s[-1])
    return Trajectory.from_poses(times, recorded.at(times) @ correction.at(within))


def pairs_of(positions: FloatArray) -> list[tuple[int, int]]:
    """Return pairs (later, earlier) of sweeps at positions (T, 3) that are matched."""
    pairs = []
    for at in range(1, len(positions)):
        for lag in LAGS:
            if lag <= at and np.linalg.norm(positions[at] - positions[at - lag]) < PAIR_M:
                pairs.append((at, at - lag))
        old = np.arange(0, max(0, at - 2 * LAGS[-1] // 3), 5)
        if len(old):
            away = np.linalg.norm(positions[old] - positions[at], axis=1)
            nearest = int(old[away.argmin()])
            if away.min() < LOOP_M and (at, nearest) not in pairs:
                pairs.append((at, nearest))
    return pairs


def key_times(recorded: Trajectory, sweeps: Sequence[PlaneSweep]) -> FloatArray:
    """Return the times (K,) at which the poses of two or more sweeps are corrected."""
    middles = np.array([sweep.middle_s for sweep in sweeps])
    first, last = (float(end(np.concatenate([sweep.time_s for sweep in sweeps]))) for end in (np.min, np.max))
    before, after = np.searchsorted(recorded.times_s, first, "right") - 1, np.searchsorted(recorded.times_s, last)
    keys = recorded.times_s[max(before, 0) : after + 1]
    sparse = len(keys) > 1 and float(np.median(np.diff(keys))) >= SPARSE_KEYS * float(np.median(np.diff(middles)))
    return keys if sparse else middles


def refine(
    sweeps: Sequence[PlaneSweep], recorded: Trajectory, progress: Callable[[float], object] = lambda share: None
) -> Refined:
    """Return the correction of a LiDAR's ``recorded`` trajectory by two or more sweeps, in order of time."""
    spatial = import_scipy("to refine poses,")
    middles = np.array([sweep.middle_s for sweep in sweeps])
    keys = key_times(recorded, sweeps)
    shift, turn = np.zeros((len(keys), 3)), np.tile([1.0, 0, 0, 0], (len(keys), 1))
    sources = [_source(sweep) for sweep in sweeps]
    system = _System(keys)
    passes = (*REACHES_M, *[REACHES_M[-1]] * MORE_PASSES)
    for step, reach in enumerate(passes):
        track = corrected(recorded, Trajectory(keys, shift, turn))
        poses = track.at(middles)
        if step % 4 == 0:
            targets = [_Target(sweep, track, pose, spatial) for sweep, pose in zip(sweeps, poses, strict=True)]
            pairs = pairs_of(poses[:, :3, 3])
        moved = [_Source(sweep, at, track) for sweep, at in zip(sweeps, sources, strict=True)]
        system.clear()
        for later, earlier in pairs:
            for a, b in ((later, earlier), (earlier, later)):
                _match(moved[a], targets[b], poses[b], reach, system)
        change = system.solve(shift, turn)
        shift, turn = _applied(shift, turn, change)
        progress((step + 1) / len(passes))
        moves_m = np.linalg.norm(np.diff(change[:, :3], axis=0), axis=1)
        moves_rad = np.linalg.norm(np.diff(change[:, 3:], axis=0), axis=1)
        if step >= len(REACHES_M) and moves_m.max() < STANDS_M and moves_rad.max() < STANDS_RAD:
            break
    correction = Trajectory(keys, shift, turn)
    return Refined(_in_place(recorded, correction), *system.deviations())


def _in_place(recorded: Trajectory, correction: Trajectory) -> Trajectory:
    """Return the correction with which the trajectory as a whole lies where the recorded one does: sweeps do not tell."""
    there = recorded.at(correction.times_s)
    here = there @ correction.poses
    world = np.eye(4)
    world[:3, :3] = nearest_rotation((there[:, :3, :3] @ here[:, :3, :3].swapaxes(1, 2)).mean(0))
    world[:3, 3] = (there[:, :3, 3] - here[:, :3, 3] @ world[:3, :3].T).mean(0)
    return Trajectory.from_poses(correction.times_s, invert_pose(there) @ world @ here)


def _source(sweep: PlaneSweep) -> NDArray[np.int64]:
    """Points that are matched: of the ground, which tells nothing of the way ahead, no more than of all else."""
    ground = np.flatnonzero(np.abs(sweep.normals[:, 2]) > GROUND)
    other = np.flatnonzero(np.abs(sweep.normals[:, 2]) <= GROUND)
    some = min(len(ground), max(POINTS // 3, POINTS - len(other)))
    rest = min(len(other), POINTS - some)
    chosen = [part[np.linspace(0, len(part) - 1, n).astype(int)] for part, n in ((ground, some), (other, rest)) if n]
    return np.concatenate(chosen) if chosen else np.zeros(0, np.int64)


class _Source:
    """Points of a sweep to be matched: in their own frames, in the world, and their rotations."""

    def __init__(self, sweep: PlaneSweep, at: NDArray[np.int64], track: Trajectory) -> None:
        self.own, self.time_s = sweep.points[at], sweep.time_s[at]
        poses = track.at(self.time_s)
        self.rotation = poses[:, :3, :3]
        self.world = np.einsum("nij,nj->ni", self.rotation, self.own) + poses[:, :3, 3]


class _Target:
    """Planes of a sweep as a whole: in the sensor's frame at the sweep's middle, with a tree of their points."""

    def __init__(self, sweep: PlaneSweep, track: Trajectory, pose: FloatArray, spatial: Any) -> None:
        self.sweep = sweep
        self.points = (placed(track, sweep.points, sweep.time_s) - pose[:3, 3]) @ pose[:3, :3]
        world = np.einsum("nij,nj->ni", track.at(sweep.time_s)[:, :3, :3], sweep.normals)
        self.normals = world @ pose[:3, :3]
        self.tree = spatial.cKDTree(self.points)


def _match(source: _Source, target: _Target, pose: FloatArray, reach: float, system: _System) -> None:
    """Add matches of a sweep's points with planes of another, whose middle is at ``pose``, to the normal equations."""
    if not len(source.own) or not len(target.points):
        return
    there = (source.world - pose[:3, 3]) @ pose[:3, :3]
    distance, near = target.tree.query(there, distance_upper_bound=reach, workers=-1)
    met = np.flatnonzero(np.isfinite(distance))
    if len(met) < LEAST_MATCHES:
        return
    near = near[met]
    normal = target.normals[near]
    residual = np.sum(normal * (there[met] - target.points[near]), 1)
    scale = max(NOISE_M, 1.4826 * float(np.median(np.abs(residual))))
    weight = INDEPENDENT / (1 + (residual / scale) ** 2) ** 2 / scale**2  # Geman and McClure's
    # derivatives by perturbations from the right: of the point's pose, and of the plane's
    own = np.einsum("nji,nj->ni", source.rotation[met], normal @ pose[:3, :3].T)
    plane, point = target.sweep.normals[near], target.sweep.points[near]
    rows = (
        (np.concatenate([own, np.cross(source.own[met], own)], 1), source.time_s[met]),
        (-np.concatenate([plane, np.cross(point, plane)], 1), target.sweep.time_s[near]),
    )
    system.add(rows, residual, weight)


class _System:
    """Normal equations of corrections (K, 6) at keys: shifts, turns, in the sensor's frame at each key, linear between
    keys."""

    def __init__(self, keys: FloatArray) -> None:
        self.keys, self.count = keys, len(keys)
        self.clear()

    def clear(self) -> None:
        self.blocks: dict[tuple[int, int], FloatArray] = {}
        self.right = np.zeros((self.count, 6))

    def _block(self, a: int, b: int, value: FloatArray) -> None:
        if (a, b) in self.blocks:
            self.blocks[a, b] += value
        else:
            self.blocks[a, b] = value.copy()  # views share memory

    def add(self, rows: Sequence[tuple[FloatArray, FloatArray]], residual: FloatArray, weight: FloatArray) -> None:
        """Add residuals (N,), and for each of the poses that they depend on derivatives (N, 6) and times (N,)."""
        parts: dict[int, FloatArray] = {}
        for jacobian, time_s in rows:
            lower = np.clip(np.searchsorted(self.keys, time_s, side="right") - 1, 0, self.count - 2)
            after = np.clip((time_s - self.keys[lower]) / (self.keys[lower + 1] - self.keys[lower]), 0, 1)
            for key in np.unique(lower).tolist():
                here = lower == key
                for at, share in ((key, 1 - after), (key + 1, after)):
                    part = parts.setdefault(at, np.zeros_like(jacobian))
                    part += jacobian * (share * here)[:, None]
        weighted = {key: part * weight[:, None] for key, part in parts.items()}
        for a, part in weighted.items():
            self.right[a] -= part.T @ residual
            for b, other in parts.items():
                self._block(a, b, part.T @ other)

    def solve(self, shift: FloatArray, turn: FloatArray) -> FloatArray:
        """Return changes (K, 6) of corrections that are now ``shift``, ``turn``."""
        now = np.concatenate([shift, 2 * turn[:, 1:]], 1)
        step = np.diag([1 / STEP_M**2] * 3 + [1 / STEP_RAD**2] * 3)
        for at in range(self.count):  # a key between sweeps has no block of its own
            self._block(at, at, np.zeros((6, 6)))
        for at in range(self.count - 1):
            self._block(at, at, step)
            self._block(at + 1, at + 1, step)
            self._block(at, at + 1, -step)
            self._block(at + 1, at, -step)
            change = step @ (now[at + 1] - now[at])
            self.right[at] += change
            self.right[at + 1] -= change
        middle = self.count // 2  # where the drive lies as a whole is decided in the end
        self._block(middle, middle, np.eye(6) * PINNED)
        from scipy.sparse.linalg import splu

        return np.asarray(splu(self._matrix()).solve(self.right.ravel()).reshape(self.count, 6))

    def _matrix(self) -> Any:
        from scipy.sparse import coo_matrix

        keys = np.array(list(self.blocks))
        values = np.stack(list(self.blocks.values()))
        rows = keys[:, 0, None, None] * 6 + np.arange(6)[:, None] + np.zeros((6, 6), int)
        columns = keys[:, 1, None, None] * 6 + np.arange(6)[None] + np.zeros((6, 6), int)
        shape = (self.count * 6, self.count * 6)
        return coo_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape).tocsc()

    def deviations(self) -> tuple[FloatArray, FloatArray]:
        """Return standard deviations (K,) of corrections relative to the middle one's, metres and radians."""
        from scipy.sparse.linalg import splu

        factor = splu(self._matrix())
        out = np.zeros((self.count, 6))
        for at in range(self.count):
            unit = np.zeros((self.count * 6, 6))
            unit[at * 6 : at * 6 + 6] = np.eye(6)
            out[at] = np.maximum(np.diag(factor.solve(unit)[at * 6 : at * 6 + 6]), 0)
        return np.sqrt(out[:, :3].sum(1)), np.sqrt(out[:, 3:].sum(1))


def _applied(shift: FloatArray, turn: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    from scipy.spatial.transform import Rotation

    small = make_pose(change[:, :3], quaternion_from_matrix(Rotation.from_rotvec(change[:, 3:]).as_matrix()))
    poses = make_pose(shift, turn) @ small
    return poses[:, :3, 3], quaternion_from_matrix(poses[:, :3, :3])
