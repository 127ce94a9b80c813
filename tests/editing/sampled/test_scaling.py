"""Scales of objects from their matrices."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import make_pose, quaternion_from_yaw
from unisim_blender.editing.sampled.scene import CHANGING, MIRRORED, SHEARED, Scaling, scaling_of


def test_factors_of_matrices_whatever_way_they_turn() -> None:
    poses = np.stack([make_pose(np.array([3.0, 2, 1]), quaternion_from_yaw(angle)) for angle in (0.0, 1.0, 4.0)])
    matrices = (poses @ np.diag([1.5, 1.0, 0.7, 1.0])).astype(np.float32)
    assert scaling_of(matrices, poses) == Scaling((1.5, 1.0, 0.7))
    assert scaling_of(poses.astype(np.float32), poses) == Scaling()
    assert scaling_of(poses @ np.diag([1.00005, 1, 1, 1.0]), poses) == Scaling()
    assert scaling_of(poses @ np.diag([1.5, -1.0, 1, 1.0]), poses).fault == MIRRORED
    leaning = np.eye(4)
    leaning[0, 1] = 0.05
    assert scaling_of(poses @ leaning, poses).fault == SHEARED
    growing = matrices.copy()
    growing[2, :3, 0] *= 1.1
    assert scaling_of(growing, poses).fault == CHANGING
    assert scaling_of(growing, poses, np.array([True, True, False])).fault == ""
