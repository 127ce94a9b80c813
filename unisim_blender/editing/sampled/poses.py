"""Poses between core's axes and Blender's, and which of them count as the same.

World, ego and actor boxes have the same axes in both. A Blender camera looks along -z with y up; core's cameras look
along z with y down.
"""

from __future__ import annotations

import numpy as np

from ...core.geometry import BoolArray, FloatArray, nearest_rotation

BLENDER_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Also its own inverse."""
SAME_M, SAME_RAD = 1e-4, 1e-5
"""Within these an object stands where it was imported."""
FLOAT32_ULP = 2.0**-23


def rigid(matrices: FloatArray) -> FloatArray:
    """Blender's matrices (..., 4, 4) as rigid poses: scale and shear are taken away."""
    poses = np.array(matrices, np.float64)
    axes = poses[..., :3, :3] / np.maximum(np.linalg.norm(poses[..., :3, :3], axis=-2, keepdims=True), 1e-12)
    # float32 axes are orthogonal to 1e-7 only; the nearest rotation is what is meant
    poses[..., :3, :3] = nearest_rotation(axes)
    return poses


def optical(poses: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) of cameras: Blender's from core's, and the other way round."""
    return poses @ BLENDER_FROM_OPTICAL


def same(a: FloatArray, b: FloatArray) -> BoolArray:
    """Which poses (..., 4, 4) agree to `SAME_M` and `SAME_RAD`, and to what Blender's float32 can tell: (...) bool."""
    return same_place(a, b) & same_turn(a, b)


def same_place(a: FloatArray, b: FloatArray) -> BoolArray:
    """Which positions of poses (..., 4, 4) agree: (...) bool."""
    away = np.linalg.norm(a[..., :3, 3] - b[..., :3, 3], axis=-1)
    return np.asarray(away <= SAME_M + 4 * FLOAT32_ULP * np.abs(b[..., :3, 3]).max(-1))


def same_turn(a: FloatArray, b: FloatArray) -> BoolArray:
    """Which rotations of poses (..., 4, 4) agree: (...) bool. A turn by a small angle moves axes by sqrt(2)
    times it in all."""
    turn = np.linalg.norm(a[..., :3, :3] - b[..., :3, :3], axis=(-2, -1)) / np.sqrt(2)
    return np.asarray(turn <= SAME_RAD)
