"""Trajectories that stand have the same bits at all times; many made at once are those made by themselves."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray, Trajectory, TrajectoryError, slerp, split_trajectories


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
