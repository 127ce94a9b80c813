"""Rows of copies: where they stand, beside which path, and what stays free."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.scenario import apply_scenario
from unisim_blender.core.scenario.edits import Row
from unisim_blender.core.scenario.edits.row import clear
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.world.drive import Actor, Appearance, Drive

TIMES: FloatArray = np.arange(41) / 10


def actor(uid: str, x: float, y: float, yaw: float = 0.0, moving_m_s: float = 0.0) -> Actor:
    """A car of 4 x 2 x 1.5 m on the ground, at 0 s at a place."""
    places = np.stack([x + moving_m_s * TIMES, np.full(41, y), np.full(41, 0.75)], -1)
    trajectory = Trajectory(TIMES, places, quaternion_from_yaw(np.full(41, yaw)))
    size_m = np.array([4.0, 2.0, 1.5])
    return Actor(uid, "Car", size_m, trajectory, -1.0, 5.0, moving_m_s != 0.0, Appearance(uid))


def drive_with(*actors: Actor) -> Drive:
    """An ego vehicle that drives 40 m along x, then as far along a quarter of a circle to the left, and actors."""
    turn: FloatArray = np.linspace(0, np.pi / 2, 41)
    bend = np.stack([40 + 25 * np.sin(turn), 25 - 25 * np.cos(turn), 0 * turn], -1)
    places = np.concatenate([np.stack([np.linspace(0, 40, 41), np.zeros(41), np.zeros(41)], -1), bend[1:]])
    headings = np.concatenate([np.zeros(41), turn[1:]])
    ego = Trajectory(np.arange(81) / 20, places, quaternion_from_yaw(headings))
    return Drive(
        name="d", frames=tuple(range(41)), time_s=dict(enumerate(TIMES.tolist())), world_from_ego=ego, cameras={}, lidars={},
        actors={each.uid: each for each in actors},
    )  # fmt: skip


def row(drive: Drive, **members: Any) -> list[Actor]:
    """The copies of a row."""
    edit = Row("parked", "p", **{"along": "ego", "start_m": 0.0, "end_m": 20.0, **members})
    scenario = Scenario(name="s", log="s", edits=(edit,), path=Path("s.json"))
    edited = apply_scenario(scenario, drive, lambda path: {})
    return [each for uid, each in edited.actors.items() if uid not in drive.actors]


def places(actors: list[Actor]) -> FloatArray:
    """Places (N, 3)."""
    return np.array([each.world_from_actor.positions[0] for each in actors])


PARKED = actor("parked", 5.0, 60.0)


def test_a_row_is_even_and_stands_on_the_ground() -> None:
    copies = row(drive_with(PARKED), count=3, left_m=-3.0)
    assert places(copies) == pytest.approx(np.array([[0, -3, 0.75], [10, -3, 0.75], [20, -3, 0.75]]), abs=1e-6)
    assert [each.uid for each in copies] == ["p 1", "p 2", "p 3"] and not any(each.is_moving for each in copies)
    spaced = places(row(drive_with(PARKED), spacing_m=7.0, left_m=-3.0, end_left_m=1.0))
    assert spaced == pytest.approx(np.array([[0, -3, 0.75], [7, -1.6, 0.75], [14, -0.2, 0.75]]), abs=1e-6)


def test_a_row_goes_round_the_turn() -> None:
    copies = row(drive_with(PARKED), start_m=50.0, end_m=70.0, count=5, left_m=-5.0)
    away = np.linalg.norm(places(copies)[:, :2] - [40, 25], axis=1)
    assert away == pytest.approx(np.full(5, 30.0), abs=0.1)
    ahead = np.array([each.world_from_actor.at(0.0)[:2, 0] for each in copies])
    tangent = (places(copies)[:, :2] - [40, 25])[:, ::-1] * [-1, 1] / away[:, None]
    assert ((ahead * tangent).sum(1) > 0.999).all()


def test_where_something_stands_or_comes_by_stays_free() -> None:
    others = actor("other", 10.0, -3.5), actor("passing", -40.0, -3.0, moving_m_s=10.5)
    assert len(row(drive_with(PARKED, others[0]), count=3, left_m=-3.0)) == 2
    assert len(row(drive_with(PARKED, *others), count=3, left_m=-3.0)) == 1, "the other one passes 0 m"
    assert len(row(drive_with(PARKED, replace(others[0], start_s=9.0, end_s=9.5)), count=3, left_m=-3.0)) == 3


def test_boxes_from_above_meet_as_their_points_do() -> None:
    random = np.random.default_rng(3)
    size_m = np.array([4.0, 2.0, 1.5])
    own = make_pose(np.zeros((1, 3)), quaternion_from_yaw(np.zeros(1)))
    grid = np.stack(np.meshgrid(np.linspace(-1.95, 1.95, 80), np.linspace(-0.95, 0.95, 40)), -1).reshape(-1, 2)
    for _ in range(200):
        at, yaw = random.uniform(-3.5, 3.5, 2), random.uniform(-np.pi, np.pi)
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        inside = np.abs((grid - at) @ turn)
        meets = bool(((inside[:, 0] <= 1.95) & (inside[:, 1] <= 0.95)).any())
        pose = make_pose(np.array([[*at, 0.0]]), quaternion_from_yaw(np.array([yaw])))
        if not meets:  # a corner may be between points
            continue
        assert not clear(own, size_m, [(pose, size_m)])[0]
    for x, free in ((3.85, False), (3.95, True)):
        pose = make_pose(np.array([[x, 0.5, 0.0]]), quaternion_from_yaw(np.zeros(1)))
        assert clear(own, size_m, [(pose, size_m)])[0] == free


def test_the_other_paths() -> None:
    own = places(row(drive_with(replace(PARKED)), along=None, start_m=6.0, end_m=18.0, count=3))
    assert own == pytest.approx(np.array([[11, 60, 0.75], [17, 60, 0.75], [23, 60, 0.75]]), abs=1e-6)
    line = ((0.0, 0.0, 1.0), (0.0, 30.0, 1.0))
    drawn = row(drive_with(PARKED), along=None, path=line, start_m=5.0, end_m=15.0, count=2)
    assert places(drawn) == pytest.approx(np.array([[0, 5, 1.75], [0, 15, 1.75]]), abs=1e-6)
    assert drawn[0].world_from_actor.at(0.0)[:2, 0] == pytest.approx([0.0, 1.0], abs=1e-6)
    varied = places(row(drive_with(PARKED), count=3, left_m=-3.0, variation_m=0.5))
    apart = varied - places(row(drive_with(PARKED), count=3, left_m=-3.0))
    assert 0.05 < np.abs(apart[:, 0]).max() <= 0.5 and 0.01 < np.abs(apart[:, 1]).max() <= 0.15


@pytest.mark.parametrize("wrong", [{}, {"count": 2, "spacing_m": 3.0}, {"count": 2, "path": ((0, 0, 0), (1, 0, 0))}])
def test_what_contradicts_itself_is_refused(wrong: dict[str, Any]) -> None:
    edit = Row("parked", "p", **{"along": "ego", "start_m": 0.0, "end_m": 20.0, **wrong})
    with pytest.raises(ScenarioError, match="here"):
        edit.check(Scenario(name="s", log="s", path=Path("s.json")), "here")
