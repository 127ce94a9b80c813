"""Trajectories along a drawn line, and trajectories that stand still for a while."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...core.geometry import FloatArray, quaternion_from_matrix


class Keys(NamedTuple):
    """Keys of a trajectory: frames (K,), positions (K, 3) in the world, unit quaternions wxyz (K, 4)."""

    frames: FloatArray
    positions: FloatArray
    quaternions: FloatArray


def along_line(line: FloatArray, step_m: float, height_m: float) -> Keys:
    """Return a trajectory along a line (P, 3) with a key every ``step_m``, for a box of a height whose
    underside is on the line.

    ``frames`` are arc lengths in metres. The front is ahead, the left side level.
    """
    apart = np.linalg.norm(np.diff(line, axis=0), axis=1)
    line = line[np.concatenate([[True], apart > 1e-6])]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.append(np.arange(0.0, along[-1], step_m), along[-1])
    positions = np.stack([np.interp(at, along, column) for column in line.T], -1)
    reach = min(1.0, along[-1] / 4)
    ahead = np.stack([np.interp(at + reach, along, c) - np.interp(at - reach, along, c) for c in line.T], -1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.cross([0.0, 0.0, 1.0], ahead)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    up = np.cross(ahead, left)
    return Keys(at, positions + up * height_m / 2, quaternion_from_matrix(np.stack([ahead, left, up], -1)))


def standing_still(keys: Keys, frame: float, until: float, later: FloatArray) -> Keys:
    """Return keys (K) that stand still from ``frame`` to ``until``, and then go on: ``later`` are the frames (K,) of
    the keys as they come then. What is before ``frame`` stays."""
    frames, positions, quaternions = keys
    here = np.array([np.interp(frame, frames, column) for column in positions.T])
    turn = np.array([np.interp(frame, frames, column) for column in quaternions.T])
    turn /= np.linalg.norm(turn)
    early, late = frames < frame, frames > frame
    return Keys(
        np.concatenate([frames[early], [frame, until], later[late]]),
        np.concatenate([positions[early], [here, here], positions[late]]),
        np.concatenate([quaternions[early], [turn, turn], quaternions[late]]),
    )
