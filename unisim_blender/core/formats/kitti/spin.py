"""When a turning LiDAR took each point, which way it turns, and how sure that is.

KITTI's own text says counter-clockwise, other readers of it compute clockwise. A point at the azimuth a was taken ``spin * a /
2 pi`` turns after the sensor looked forward, where spin is 1 counter-clockwise and -1 clockwise. The number is fitted: planes
that two sweeps of a moving sensor see at different azimuths fall on each other for the right one alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import FloatArray, Trajectory

WORDS = {1: "counter-clockwise", -1: "clockwise"}
_Placed = tuple[FloatArray, FloatArray, FloatArray]
Turn = tuple[float, float, float]
"""When the LiDAR looked backward, forward and backward again, seconds."""
Turns = tuple[FloatArray, FloatArray, FloatArray]
"""Of each of some points, its own turn."""
STATED = 1
"""Counter-clockwise, as KITTI's text says: taken where the recording does not tell."""
APART, PAIRS = 3, 8
"""Sweeps of a pair are so many frames apart; the fastest pairs of the drive are looked at, at most so many."""
CELL_M, AGREE = 0.3, 0.95
"""Points of two sweeps in a cell of this size, whose normals have this cosine, are taken to lie on one plane."""
ACROSS = 0.3
"""Planes tell of the time by which the sensor moved across them: the cosine of its way with their normal is at least this."""
FEWEST = 30
"""Points of a pair that tell a spin."""
SURE = 4.0
"""A spin that is fewer standard errors from 0 is not told."""


@dataclass(frozen=True)
class Spin:
    """A direction (1: counter-clockwise), whether the recording tells it, and the sentence that says so."""

    direction: int
    told: bool
    sentence: str


@dataclass(frozen=True)
class PlanePoints:
    """Points on planes, and the planes' normals (N, 3), in the sensor's frame at each point's own time."""

    points: FloatArray
    normals: FloatArray


def point_times(points: FloatArray, turn: Turn | Turns, spin: float) -> FloatArray:
    """Return when each point (N, 3+) was taken (N,): by its azimuth; all at once in a turn for ``spin`` 0."""
    fraction = spin * np.arctan2(points[:, 1], points[:, 0]) / np.pi  # -1 as the turn starts, 1 as it ends
    start, forward, end = turn
    return np.asarray(forward + np.where(fraction < 0, fraction * (forward - start), fraction * (end - forward)))


def fit_spin(
    frames: Sequence[int], read: Callable[[int], PlanePoints], turns: dict[int, Turn], track: Trajectory
) -> Spin:
    """Return the spin that the sweeps of ``frames`` tell, whose sensor's world poses are ``track``."""
    pairs = [(frames[at], frames[at + APART]) for at in range(len(frames) - APART)]
    moved = [np.linalg.norm(np.subtract(*track.positions_at(np.array([turns[a][1], turns[b][1]])))) for a, b in pairs]
    chosen = sorted(pairs[at] for at in np.argsort(np.negative(moved), kind="stable")[:PAIRS])
    placed: dict[int, _Placed] = {}
    spins = []
    for pair in chosen:
        for frame in pair:
            if frame not in placed:
                placed[frame] = _place(read(frame), turns[frame], track)
        found = _spin_of(placed[pair[0]], placed[pair[1]])
        if found is not None:
            spins.append(found)
    return decide(np.array(spins))


def decide(spins: FloatArray) -> Spin:
    """Return what the spins (K,) of pairs of sweeps tell together."""
    if len(spins) < 2:
        return Spin(
            STATED, False, f"nothing tells which way the LiDAR turns: {WORDS[STATED]} is taken, as KITTI states"
        )
    # pairs share sweeps, so they tell less than so many independent ones
    middle, error = float(np.median(spins)), float(1.4826 * np.median(np.abs(spins - np.median(spins))))
    error = max(error / np.sqrt(len(spins) / APART), 0.01)
    fitted = f"{middle:+.2f} ± {error:.2f}, where +1 is counter-clockwise and -1 clockwise"
    direction = 1 if middle > 0 else -1
    if abs(middle) < SURE * error or abs(abs(middle) - 1) > 0.6:
        why = f"the sweeps do not tell which way the LiDAR turns (fitted spin {fitted}; a slow drive, or poses that do not fit)"
        return Spin(STATED, False, f"{why}: {WORDS[STATED]} is taken, as KITTI states")
    return Spin(direction, True, f"the LiDAR turns {WORDS[direction]} (fitted spin {fitted})")


def _place(planes: PlanePoints, turn: Turn, track: Trajectory) -> _Placed:
    """Points in the world for spin 0, by how much spin moves them, and their normals there: (N, 3) each."""
    ends = []
    for spin in (1.0, -1.0):
        poses = track.at(point_times(planes.points, turn, spin))
        ends.append(np.einsum("nij,nj->ni", poses[:, :3, :3], planes.points) + poses[:, :3, 3])
    normals = planes.normals @ track.at(turn[1])[:3, :3].T
    return (ends[0] + ends[1]) / 2, (ends[0] - ends[1]) / 2, normals


def _spin_of(first: _Placed, second: _Placed) -> float | None:
    """The spin for which the planes of two sweeps fall on each other best; None where too few tell."""
    one, other = _same_cells(first[0], second[0])
    normal = first[2][one]
    agree = np.sum(normal * second[2][other], 1) > AGREE
    moves = second[1][other] - first[1][one]
    apart = np.sum(normal * (second[0][other] - first[0][one]), 1)
    lever = np.sum(normal * moves, 1)
    used = agree & (np.abs(lever) > ACROSS * np.linalg.norm(moves, axis=1))
    if used.sum() < FEWEST:
        return None
    return _slope(lever[used], -apart[used])


def _same_cells(first: FloatArray, second: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of points (N, 3) and (M, 3) that share a cell, one of each a cell."""
    low = np.minimum(first.min(0, initial=np.inf), second.min(0, initial=np.inf))
    cells = [np.floor((points - low) / CELL_M).astype(np.int64) for points in (first, second)]
    span = np.maximum(cells[0].max(0, initial=0), cells[1].max(0, initial=0)) + 1
    keys = [(cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2] for cell in cells]
    _, one, other = np.intersect1d(keys[0], keys[1], return_indices=True)
    return one, other


def _slope(x: FloatArray, y: FloatArray) -> float:
    """The slope of y over x through the origin, least squares with Tukey's weights."""
    slope = 0.0
    for _ in range(10):
        off = y - slope * x
        scale = max(4.7 * 1.4826 * float(np.median(np.abs(off))), 1e-6)
        weight = np.maximum(1 - (off / scale) ** 2, 0) ** 2
        slope = float((weight * x * y).sum() / max((weight * x * x).sum(), 1e-12))
    return slope
