"""Trajectories shifted along their own path: by arc length, so that what turns is shifted round the
turn. numpy alone."""

from __future__ import annotations

import numpy as np

from ...core.geometry import FloatArray, matrix_from_quaternion, quaternion_from_matrix, slerp

STEP_M = 0.3
"""Between two vertices of the path. Annotations of what stands still wander by centimetres, which is no path."""
END_M = 2.0
"""From how long a piece of the path its direction beyond its ends is taken."""
SAME_FRAME = 1e-6
"""Keys nearer than this to each other are one."""


def path_of(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return which of the positions (K, 3) are a path's vertices, as indices (V,), and their arc
    lengths (V,) in metres.

    A vertex is at least `STEP_M` from the one before. What never goes so far has one vertex.
    """
    kept = [0]
    for i in range(1, len(positions)):
        if np.linalg.norm(positions[i] - positions[kept[-1]]) >= STEP_M:
            kept.append(i)
    vertices = np.array(kept)
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
    here = _arc_lengths(positions, vertices, along)
    there = here + ahead_m
    apart = _points(corners, along, there) - _points(corners, along, here)
    turns = matrix_from_quaternion(_turns(quaternions[vertices], along, there)) @ np.swapaxes(
        matrix_from_quaternion(_turns(quaternions[vertices], along, here)), -1, -2
    )
    return positions + apart, quaternion_from_matrix(turns @ matrix_from_quaternion(quaternions))


def shifted_keys(
    frames: FloatArray, positions: FloatArray, quaternions: FloatArray, whole: FloatArray, ahead_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return keys at frames (K,), positions (K, 3) and quaternions (K, 4), moved along their path, with keys at the
    ``whole`` frames (N,) between them too: between two keys the path may turn at what was a key before."""
    inside = whole[(whole > frames[0]) & (whole < frames[-1])]
    every = np.unique(np.concatenate([frames, inside]))
    every = every[np.concatenate([[True], np.diff(every) > SAME_FRAME])]
    return every, *shifted_along(_at(every, frames, positions), _unit(_at(every, frames, quaternions)), ahead_m)


def _at(wanted: FloatArray, frames: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(wanted, frames, column) for column in values.T], -1)


def _unit(quaternions: FloatArray) -> FloatArray:
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def _arc_lengths(positions: FloatArray, vertices: FloatArray, along: FloatArray) -> FloatArray:
    """Arc lengths (K,) of the path's points next to positions (K, 3), each on the piece that it lies on in time."""
    piece = np.clip(np.searchsorted(vertices, np.arange(len(positions)), side="right") - 1, 0, len(vertices) - 2)
    start, end = positions[vertices[piece]], positions[vertices[piece + 1]]
    share = ((positions - start) * (end - start)).sum(1) / ((end - start) ** 2).sum(1)
    return np.asarray(along[piece] + np.clip(share, 0, 1) * np.diff(along)[piece])


def _points(corners: FloatArray, along: FloatArray, at: FloatArray) -> FloatArray:
    """Points (K, 3) of a path at arc lengths (K,), which may lie beyond its ends."""
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
