"""Trajectories as lines: the object's own with its speeds, and the recorded one where that differs."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from helpers import imported

from unisim_blender.bridge.changes.motion import displaced_along
from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.views.trails import trail, trajectory_poses
from unisim_blender.editing.layout.trails import RECORDED, speed_colours
from unisim_blender.editing.sampled.clock import Clock


def test_a_way_is_where_the_actor_goes(street: Any) -> None:
    drive = source_of(street).drive
    clock = Clock.of(drive)
    uid = next(u for u, a in sorted(drive.actors.items()) if a.is_moving and a.start_s <= 0)
    one = imported(street, "ACTOR", uid)
    street.frame_set(5)
    lines = trail(one, drive, clock, 5.0)
    assert not (lines.colours == RECORDED).all(1).any()
    poses = trajectory_poses(one, clock)
    assert poses is not None
    assert np.abs(poses[:, :3, 3] - drive.actors[uid].world_from_actor.at(clock.times_s)[:, :3, 3]).max() < 1e-3
    displaced_along(one, (0.0, 3.0, 0.0))
    street.frame_set(6)
    lines = trail(one, drive, clock, 6.0)
    grey = (lines.colours == RECORDED).all(1)
    assert grey.sum() == 2 * (len(clock.frames) - 1) + 24  # the recorded line, and a box


def test_faster_is_redder(street: Any) -> None:
    clock = Clock(np.arange(5.0), np.arange(5.0) * 0.1)
    poses = np.tile(np.eye(4), (5, 1, 1))
    slow, fast = poses.copy(), poses.copy()
    slow[:, 0, 3], fast[:, 0, 3] = 0.1 * np.arange(5), 1.4 * np.arange(5)
    assert (speed_colours(fast, clock)[:, 0] > speed_colours(slow, clock)[:, 0]).all()


def test_between_keys_a_way_is_as_blender_interpolates(street: Any) -> None:
    drive = source_of(street).drive
    clock = Clock.of(drive)
    uid = next(u for u, a in sorted(drive.actors.items()) if a.is_moving and a.start_s <= 0)
    one = imported(street, "ACTOR", uid)
    for frame, left in ((4, 0.0), (14, 3.0)):  # Blender eases in and out
        bpy.context.scene.frame_set(frame)
        one.location = (0.0, left, 0.0)
        one.keyframe_insert("location", frame=frame)
    poses = trajectory_poses(one, clock)
    assert poses is not None
    for frame in (2, 6, 12, 17):
        street.frame_set(frame)
        at = int(np.flatnonzero(clock.frames == frame)[0])
        assert np.abs(poses[at, :3, 3] - np.array(one.matrix_world.translation)).max() < 1e-4
