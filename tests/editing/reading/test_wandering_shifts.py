"""Shifts of actors whose labels wander, or who come later than the drive's first frame, read off keys as Blender has
them."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.world.drive import Actor, Appearance, Drive
from unisim_blender.editing.edits.reader import ActorEditContext, ReadContext
from unisim_blender.editing.motion.keys import continuous, dense, shifted_keys
from unisim_blender.editing.readers.actors import shift_of
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import Sampled, SampledObject

FRAMES_S: FloatArray = np.arange(80) / 10 + np.random.default_rng(4).normal(0, 0.0002, 80)


def wandering(begins: int) -> Actor:
    """A car that turns, labelled a little after each frame from a frame on, its labels wandering by centimetres."""
    times, random = FRAMES_S[begins:] + 0.03, np.random.default_rng(5)
    yaw = 0.1 * times
    places = np.stack([80 * np.sin(yaw), 80 - 80 * np.cos(yaw), 0 * yaw + 0.8], -1) + random.normal(
        0, 0.02, (len(yaw), 3)
    )
    trajectory = Trajectory(times, places, quaternion_from_yaw(yaw + random.normal(0, 0.002, len(yaw))))
    return Actor("a", "Car", np.array([4.0, 2.0, 1.6]), trajectory, -0.25, 8.25, True, Appearance("a"))


def in_blender(actor: Actor, clock: Clock, left_m: float, ahead_m: float, later_s: float) -> SampledObject:
    """The actor with the keys of its import, in float32, shifted as Shift Actor does, at the clock's frames."""

    def rounded(values: FloatArray) -> FloatArray:
        return np.asarray(values, np.float32).astype(float)

    keys = dense(actor.world_from_actor, clock)
    frames, places, turns = clock.frame(keys.times_s), keys.positions, continuous(keys.quaternions_wxyz)
    if ahead_m:
        frames, places, turns = shifted_keys(rounded(frames), rounded(places), turns, clock.frames, ahead_m)
    frames = rounded(clock.frame(clock.time_s(frames) + later_s))

    def at_frames(values: FloatArray) -> FloatArray:
        inside = [np.interp(clock.frames, frames, column) for column in rounded(values).T]
        before, after = np.minimum(clock.frames - frames[0], 0), np.maximum(clock.frames - frames[-1], 0)
        slopes = np.diff(values, axis=0)[[0, -1]] / np.diff(frames)[[0, -1], None]
        return np.asarray(np.stack(inside, -1) + np.outer(before, slopes[0]) + np.outer(after, slopes[1]))

    quaternions = at_frames(turns)
    poses = make_pose(at_frames(places), quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))
    poses[:, :3, 3] += left_m * poses[:, :3, 1]
    there = np.ones(len(clock.frames), bool)
    return SampledObject("a", "ACTOR", "a", "a", "", "", "", 0, poses, there, span=(frames[0], frames[-1]))


@pytest.mark.parametrize("begins", [0, 30])
@pytest.mark.parametrize("shift", [(1.25, 0.0, 0.0), (0.0, 0.0, 0.333), (0.0, 3.2, 0.0), (-0.5, -4.35, -0.4)])
def test_a_shift_is_read_with_its_numbers(begins: int, shift: tuple[float, float, float]) -> None:
    actor = wandering(begins)
    still = Trajectory(np.zeros(1), np.zeros((1, 3)), quaternion_from_yaw(np.zeros(1)))
    drive = Drive("d", tuple(range(80)), dict(enumerate(FRAMES_S.tolist())), still, {}, {}, {"a": actor})
    clock = Clock.of(drive)
    obj = in_blender(actor, clock, *shift)
    move = shift_of(ActorEditContext(ReadContext(Sampled("s", clock, (obj,)), drive, set()), obj, actor))
    assert move is not None and move.offset_m is not None
    assert (move.offset_m[1], move.later_s or 0.0) == pytest.approx((shift[0], shift[2]), abs=2e-3)
    assert (move.ahead_m or 0.0) + move.offset_m[0] == pytest.approx(shift[1], abs=0.02)
