"""Rigid poses of matrices, and which poses are the same."""

from __future__ import annotations

import numpy as np

from unisim_blender.editing.sampled.scene import optical, rigid, same, same_place, same_turn


def test_rigid_takes_scale_away() -> None:
    matrix = np.diag([2.0, 3.0, 4.0, 1.0])
    assert np.allclose(rigid(matrix), np.eye(4))


def test_cameras_look_along_minus_z_in_blender() -> None:
    pose = np.eye(4)
    assert (optical(pose)[:3, 2] == [0, 0, -1]).all() and (optical(pose)[:3, 1] == [0, -1, 0]).all()
    assert (optical(optical(pose)) == pose).all()


def test_poses_are_the_same_within_what_float32_tells() -> None:
    here = np.tile(np.eye(4), (4, 1, 1))
    there = here.copy()
    there[1, 0, 3], there[2, 0, 3] = 0.5e-4, 3e-4
    there[3, :2, :2] = [[np.cos(1e-3), -np.sin(1e-3)], [np.sin(1e-3), np.cos(1e-3)]]
    assert same(there, here).tolist() == [True, True, False, False]
    assert same_place(there, here).tolist() == [True, True, False, True]
    assert same_turn(there, here).tolist() == [True, True, True, False]
    far = here.copy()
    far[:, 0, 3] = 10_000.0
    off = far.copy()
    off[:, 0, 3] += 4e-3  # a few steps of float32 at 10 km
    assert same(off, far).all()
