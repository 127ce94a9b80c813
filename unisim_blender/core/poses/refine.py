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

from ..geometry import FloatArray, Trajectory, invert_pose, make_pose, quaternion_from_matrix
from .sweeps import SweepPlanes, first_in_voxels, import_scipy, placed

REACHES_M = (2.0, 1.0, 1.0, 0.6, 0.6, 0.4, 0.4, 0.3, 0.3, 0.3)
"""How far apart points are matched to planes, from pass to pass."""
LAGS = (1, 2, 4, 8, 16, 32, 64, 128)
PAIR_M = 60.0
"""Sweeps further apart are not matched."""
POINTS = 1500
"""Points of a sweep that are matched to another."""
LEAST_MATCHES = 60
GROUND = 0.9
NOISE_M = 0.03
INDEPENDENT = 0.05
"""Share of a pair's points that count as independent: neighbours share errors of planes."""
STEP_M, STEP_RAD = 0.5, 0.02
"""Standard deviation of the change, from sweep to sweep, of the log's error: the prior where sweeps tell nothing."""
PLACE_M, PLACE_RAD = 5.0, 0.2
"""Standard deviation of the log's poses: the prior on where the drive as a whole lies."""
STANDS_M, STANDS_RAD = 5e-4, 2e-5


@dataclass(frozen=True)
class Refined:
    """A refined trajectory of a LiDAR, and the standard deviations of its poses at the sweeps' middles.

    ``correction``: from the refined frame of the sensor to the log's, at ``times_s`` of the sweeps. ``std_m``,
    ``std_rad`` (T,) are relative to the sweep in the drive's middle.
    """

    trajectory: Trajectory
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
            if away.min() < 10.0 and (at, nearest) not in pairs:
                pairs.append((at, nearest))
    return pairs


def refine(
    sweeps: Sequence[SweepPlanes], recorded: Trajectory, progress: Callable[[int], object] = lambda step: None
) -> Refined:
    """Return the LiDAR's trajectory refined from its ``recorded`` one by two or more sweeps, in order of time."""
    spatial = import_scipy("to refine poses")
    times = np.array([sweep.middle_s for sweep in sweeps])
    count = len(sweeps)
    shift, turn = np.zeros((count, 3)), np.tile([1.0, 0, 0, 0], (count, 1))
    sources = [_source(sweep) for sweep in sweeps]
    system = _System(times)
    for step, reach in enumerate((*REACHES_M, *[REACHES_M[-1]] * 6)):
        correction = Trajectory(times, shift, turn)
        track = corrected(recorded, correction)
        poses = track.at(times)
        if step % 4 == 0:
            world = [placed(track, sweep.points, sweep.time_s) for sweep in sweeps]
            clouds = [_local(pose, points) for pose, points in zip(poses, world, strict=True)]
            trees = [spatial.cKDTree(cloud) for cloud in clouds]
            normals = [_normals(track, sweep, pose) for sweep, pose in zip(sweeps, poses, strict=True)]
            pairs = pairs_of(poses[:, :3, 3])
        moved = [placed(track, sweep.points[at], sweep.time_s[at]) for sweep, at in zip(sweeps, sources, strict=True)]
        system.clear()
        for later, earlier in pairs:
            for a, b in ((later, earlier), (earlier, later)):
                system.add(_match(a, b, moved[a], poses, clouds[b], normals[b], trees[b], reach))
        change = system.solve(shift, turn)
        shift, turn = _applied(shift, turn, change)
        progress(step)
        moves_m = np.linalg.norm(np.diff(change[:, :3], axis=0), axis=1)
        moves_rad = np.linalg.norm(np.diff(change[:, 3:], axis=0), axis=1)
        if step >= len(REACHES_M) and moves_m.max() < STANDS_M and moves_rad.max() < STANDS_RAD:
            break
    std_m, std_rad = system.deviations()
    correction = Trajectory(times, shift, turn)
    return Refined(corrected(recorded, correction), correction, std_m, std_rad)


def _source(sweep: SweepPlanes) -> NDArray[np.int64]:
    """Points that are matched: of the ground, which tells nothing of the way ahead, no more than of all else."""
    ground = np.flatnonzero(np.abs(sweep.normals[:, 2]) > GROUND)
    other = np.flatnonzero(np.abs(sweep.normals[:, 2]) <= GROUND)
    some = min(len(ground), max(POINTS // 3, POINTS - len(other)))
    rest = min(len(other), POINTS - some)
    chosen = [part[np.linspace(0, len(part) - 1, n).astype(int)] for part, n in ((ground, some), (other, rest)) if n]
    return np.concatenate(chosen) if chosen else np.zeros(0, np.int64)


def _local(pose: FloatArray, points: FloatArray) -> FloatArray:
    return np.asarray((points - pose[:3, 3]) @ pose[:3, :3])


def _normals(track: Trajectory, sweep: SweepPlanes, pose: FloatArray) -> FloatArray:
    world = np.einsum("nij,nj->ni", track.at(sweep.time_s)[:, :3, :3], sweep.normals)
    return np.asarray(world @ pose[:3, :3])


@dataclass(frozen=True)
class _Match:
    a: int
    b: int
    jacobian_a: FloatArray
    jacobian_b: FloatArray
    residual: FloatArray
    weight: FloatArray


def _match(
    a: int, b: int, moved: FloatArray, poses: FloatArray, cloud: FloatArray, normals: FloatArray, tree: Any,
    reach: float,
) -> _Match | None:  # fmt: skip
    """Matches of sweep a's points with planes of b; derivatives by right perturbations of both poses."""
    there = _local(poses[b], moved)
    distance, near = tree.query(there, distance_upper_bound=reach, workers=-1)
    met = np.flatnonzero(np.isfinite(distance))
    if len(met) < LEAST_MATCHES:
        return None
    point, target, normal = there[met], cloud[near[met]], normals[near[met]]
    residual = np.sum(normal * (point - target), 1)
    scale = max(NOISE_M, 1.4826 * float(np.median(np.abs(residual))))
    weight = 1 / (1 + (residual / scale) ** 2) ** 2 / scale**2
    in_a = _local(poses[a], moved[met])
    rotation = poses[a, :3, :3].T @ poses[b, :3, :3]  # b's axes in a
    n_a = normal @ rotation.T
    return _Match(
        a, b, np.concatenate([n_a, np.cross(in_a, n_a)], 1), -np.concatenate([normal, np.cross(point, normal)], 1),
        residual, weight,
    )  # fmt: skip


class _System:
    """Normal equations of corrections (T, 6): shifts, turns, in each sweep's own frame."""

    def __init__(self, times: FloatArray) -> None:
        self.count = len(times)
        self.clear()

    def clear(self) -> None:
        self.blocks: dict[tuple[int, int], FloatArray] = {}
        self.right = np.zeros((self.count, 6))

    def _block(self, a: int, b: int, value: FloatArray) -> None:
        if (a, b) in self.blocks:
            self.blocks[a, b] += value
        else:
            self.blocks[a, b] = value.copy()  # a transpose shares memory

    def add(self, match: _Match | None) -> None:
        if match is None:
            return
        a, b, weight = match.a, match.b, match.weight[:, None] * INDEPENDENT
        wa, wb = match.jacobian_a * weight, match.jacobian_b * weight
        self._block(a, a, wa.T @ match.jacobian_a)
        self._block(b, b, wb.T @ match.jacobian_b)
        cross = wa.T @ match.jacobian_b
        self._block(a, b, cross)
        self._block(b, a, cross.T)
        self.right[a] -= wa.T @ match.residual
        self.right[b] -= wb.T @ match.residual

    def solve(self, shift: FloatArray, turn: FloatArray) -> FloatArray:
        """Return changes (T, 6) of corrections that are now ``shift``, ``turn``."""
        now = np.concatenate([shift, 2 * turn[:, 1:]], 1)
        place = np.diag([1 / PLACE_M**2] * 3 + [1 / PLACE_RAD**2] * 3)
        step = np.diag([1 / STEP_M**2] * 3 + [1 / STEP_RAD**2] * 3)
        for at in range(self.count):
            self._block(at, at, place / self.count)
            self.right[at] -= place @ now[at] / self.count
        for at in range(self.count - 1):
            self._block(at, at, step)
            self._block(at + 1, at + 1, step)
            self._block(at, at + 1, -step)
            self._block(at + 1, at, -step)
            change = step @ (now[at + 1] - now[at])
            self.right[at] += change
            self.right[at + 1] -= change
        from scipy.sparse.linalg import splu

        self.factor = splu(self._matrix())
        return np.asarray(self.factor.solve(self.right.ravel()).reshape(self.count, 6))

    def _matrix(self) -> Any:
        from scipy.sparse import coo_matrix

        keys = np.array(list(self.blocks))
        values = np.stack(list(self.blocks.values()))
        rows = keys[:, 0, None, None] * 6 + np.arange(6)[:, None] + np.zeros((6, 6), int)
        columns = keys[:, 1, None, None] * 6 + np.arange(6)[None] + np.zeros((6, 6), int)
        shape = (self.count * 6, self.count * 6)
        return coo_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape).tocsc()

    def deviations(self) -> tuple[FloatArray, FloatArray]:
        """Return standard deviations (T,) of corrections relative to the middle sweep's, metres and radians."""
        middle = self.count // 2
        out = np.zeros((self.count, 2))
        for at in range(self.count):
            if at == middle:
                continue
            unit = np.zeros((self.count * 6, 6))
            unit[at * 6 : at * 6 + 6] = np.eye(6)
            unit[middle * 6 : middle * 6 + 6] -= np.eye(6)
            variance = np.maximum(np.diag(unit.T @ self.factor.solve(unit)), 0)
            out[at] = np.sqrt(variance[:3].sum()), np.sqrt(variance[3:].sum())
        return out[:, 0], out[:, 1]


def _applied(shift: FloatArray, turn: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    from scipy.spatial.transform import Rotation

    small = make_pose(change[:, :3], quaternion_from_matrix(Rotation.from_rotvec(change[:, 3:]).as_matrix()))
    poses = make_pose(shift, turn) @ small
    return poses[:, :3, 3], quaternion_from_matrix(poses[:, :3, :3])
