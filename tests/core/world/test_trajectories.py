"""Trajectories that stand have the same bits at all times; many made at once are those made by themselves."""

from __future__ import annotations

import numpy as np
import pytest
from turning_drive import arc

from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    TrajectoryError,
    make_pose,
    quaternion_from_yaw,
    slerp,
    split_trajectories,
)
from unisim_blender.core.scenario.motion.trajectories import Poses, Stacked, sampled, sampled_together


def keys(count: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.sqrt((quaternions * quaternions).sum(1, keepdims=True))
    return np.cumsum(rng.uniform(0.01, 1, count)), rng.normal(0, 100, (count, 3)), quaternions


def test_between_equal_keys_a_pose_is_theirs_to_the_bit() -> None:
    times, positions, quaternions = keys(40, 1)
    times, positions, quaternions = (
        np.stack([times, times + 0.003], 1).ravel(),
        *(np.repeat(one, 2, 0) for one in (positions, quaternions)),
    )
    trajectory = Trajectory(times, positions, quaternions)
    for key in range(0, 80, 2):
        at = np.linspace(times[key], times[key + 1], 17, endpoint=False)
        place, turn = trajectory.placed_at(at)
        assert (place == positions[key]).all() and (turn == quaternions[key]).all()
        assert (trajectory.at(at) == trajectory.at(times[key])).all()
    a, b = quaternions[0], quaternions[2]
    assert not np.array_equal(slerp(a, b, np.array(0.5)), a)


def test_split_trajectories_are_those_made_by_themselves() -> None:
    arrays, counts = keys(30, 2), [1, 4, 20, 5]
    # the second begins before the first ends
    times = np.concatenate([arrays[0][:1], *(arrays[0][:count] for count in counts[1:])])
    found = split_trajectories(times, *arrays[1:], counts)
    first = 0
    for one, count in zip(found, counts, strict=True):
        part = slice(first, first := first + count)
        assert one.content() == Trajectory(times[part], arrays[1][part], arrays[2][part]).content()
    assert split_trajectories(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)), []) == []


@pytest.mark.parametrize("fault", ["time", "number", "length"])
def test_faults_of_split_trajectories_are_named(fault: str) -> None:
    times, positions, quaternions = keys(6, 3)
    if fault == "time":
        times[4] = times[3]
    elif fault == "number":
        positions[2, 1] = np.nan
    else:
        quaternions[5] *= 2
    with pytest.raises(TrajectoryError):
        split_trajectories(times, positions, quaternions, [3, 3])


def test_nearly_unit_quaternions_are_normalised_in_both() -> None:
    times, positions, quaternions = keys(6, 4)
    quaternions[1] *= 1 + 1e-5
    found = split_trajectories(times, positions, quaternions, [3, 3])[0]
    assert found.content() == Trajectory(times[:3], positions[:3], quaternions[:3]).content()
    assert abs(np.linalg.norm(found.quaternions_wxyz[1]) - 1) < 1e-12


def test_trajectories_sampled_together_are_those_sampled_alone() -> None:
    """To the bit: of one that turns sharply, one that hardly does, and a single key; and so are poses asked for together."""
    turning, straight = arc(np.linspace(0, 2, 5), (0, 0, 0), 6.0, 1.2), arc(np.linspace(-1, 2, 9), (5, 1, 0), 9.0, 1e-3)
    standing = Trajectory(np.array([0.7]), np.array([[1.0, 2, 3]]), quaternion_from_yaw(np.array([0.4])))
    several = [turning, standing, straight]
    arm = make_pose(np.array([3.0, 1.0, 0.5]), quaternion_from_yaw(0.3))
    times = [np.linspace(-0.5, 2.5, 4), np.array([0.0, 1.0]), np.linspace(0, 2, 3)]
    stacked = Stacked(several)

    together = sampled_together(lambda t, which: stacked.at(t, which) @ arm, times)

    def moved(one: Trajectory) -> Poses:
        return lambda t: one.at(t) @ arm

    alone = [sampled(moved(one), own) for one, own in zip(several, times, strict=True)]

    assert [one.content() for one in together] == [one.content() for one in alone]
    assert len(together[0].times_s) > 50 > len(together[2].times_s)
