"""Shifts of a trajectory along its own path by arc length, so that what turns is shifted round the turn."""

from __future__ import annotations

import numpy as np

from ...geometry import FloatArray, Trajectory, matrix_from_quaternion, quaternion_from_matrix, slerp
from .trajectories import merged_times, sampled_keys

STEP_M = 0.3
"""Between two vertices of the path. Annotations of what stands still wander by centimetres, which is no path."""
END_M = 2.0
"""From how long a piece of the path its direction beyond its ends is taken."""


def path_of(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return which of the positions (K, 3) are a path's vertices, as indices (V,), and their arc
    lengths (V,) in metres.

    A vertex is at least `STEP_M` from the one before. What never goes so far has one vertex.
    """
    indices = [0]
    for i in range(1, len(positions)):
        if np.linalg.norm(positions[i] - positions[indices[-1]]) >= STEP_M:
            indices.append(i)
    vertices = np.array(indices)
    steps = np.linalg.norm(np.diff(positions[vertices], axis=0), axis=1)
    return vertices, np.concatenate([[0.0], np.cumsum(steps)])


def is_path(positions: FloatArray) -> bool:
    """Return whether positions (K, 3) go anywhere, so that there is a path to shift something along."""
    return len(path_of(positions)[0]) > 1


def shifted_along(positions: FloatArray, quaternions: FloatArray, ahead_m: float) -> tuple[FloatArray, FloatArray]:
    """Return positions (K, 3) and unit quaternions wxyz (K, 4) moved along their path by an arc length,
    forward positive.

    A key that has gone s metres is displaced and turned as the path displaces and turns from s to s + ``ahead_m``; what
    it is off the path, it stays off. Beyond its ends the path goes on straight. Raises `ValueError` where
    there is no path.
    """
    vertices, along = path_of(positions)
    if len(vertices) < 2:
        raise ValueError("what stands still has no path to be shifted along")
    corners = positions[vertices]
    here = arc_lengths(positions, vertices, along)
    there = here + ahead_m
    apart = points_along(corners, along, there) - points_along(corners, along, here)
    turns = matrix_from_quaternion(_turns(quaternions[vertices], along, there)) @ np.swapaxes(
        matrix_from_quaternion(_turns(quaternions[vertices], along, here)), -1, -2
    )
    return positions + apart, quaternion_from_matrix(turns @ matrix_from_quaternion(quaternions))


def arc_lengths(positions: FloatArray, vertices: FloatArray, along: FloatArray) -> FloatArray:
    """Return arc lengths (K,) of the path's points next to positions (K, 3), each on the piece that it lies on in time."""
    piece = np.clip(np.searchsorted(vertices, np.arange(len(positions)), side="right") - 1, 0, len(vertices) - 2)
    start, end = positions[vertices[piece]], positions[vertices[piece + 1]]
    share = ((positions - start) * (end - start)).sum(1) / ((end - start) ** 2).sum(1)
    return np.asarray(along[piece] + np.clip(share, 0, 1) * np.diff(along)[piece])


def points_along(corners: FloatArray, along: FloatArray, at: FloatArray) -> FloatArray:
    """Return points (K, 3) of a path at arc lengths (K,), which may lie beyond its ends."""
    inside = np.stack([np.interp(at, along, column) for column in corners.T], -1)
    first = corners[np.searchsorted(along, min(END_M, along[-1]))] - corners[0]
    last = corners[-1] - corners[np.searchsorted(along, max(along[-1] - END_M, 0.0), side="right") - 1]
    before, after = np.minimum(at, 0.0)[:, None], np.maximum(at - along[-1], 0.0)[:, None]
    return np.asarray(inside + before * first / np.linalg.norm(first) + after * last / np.linalg.norm(last))


def _turns(quaternions: FloatArray, along: FloatArray, at: FloatArray) -> FloatArray:
    """Unit quaternions (K, 4) at arc lengths (K,): those of the ends beyond them."""
    piece = np.clip(np.searchsorted(along, at, side="right") - 1, 0, len(along) - 2)
    share = np.clip((at - along[piece]) / np.diff(along)[piece], 0, 1)
    return slerp(quaternions[piece], quaternions[piece + 1], share)


def ahead(trajectory: Trajectory, times_s: FloatArray, ahead_m: float) -> Trajectory:
    """Return a trajectory that goes somewhere, moved along its path by an arc length; it has keys at ``times_s`` (N,)
    between its own too, as the path may turn there."""
    inside = times_s[(times_s > trajectory.times_s[0]) & (times_s < trajectory.times_s[-1])]
    times = merged_times(trajectory.times_s, inside) if len(inside) else trajectory.times_s
    return Trajectory(times, *shifted_along(*sampled_keys(trajectory, times), ahead_m))


def arc_lengths_of(path: FloatArray, places: FloatArray) -> FloatArray:
    """Return how far along a path's positions (K, 3), straight on beyond its ends, the points next to places (N, 3) lie:
    (N,) in metres."""
    vertices, along = path_of(path)
    far = along[-1] + np.linalg.norm(places - path[0], axis=1).max() + 1.0
    corners = points_along(path[vertices], along, np.concatenate([[-far], along, [far]]))
    steps = np.diff(corners, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    share = np.clip(((places[:, None] - corners[:-1]) * steps).sum(-1) / lengths**2, 0, 1)
    away = np.linalg.norm(corners[:-1] + share[..., None] * steps - places[:, None], axis=-1)
    piece = away.argmin(1)
    start = np.concatenate([[-far], along])
    return np.asarray(start[piece] + share[np.arange(len(places)), piece] * lengths[piece])
