"""Turned boxes and paths against values worked out by hand, and against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.simulation.footprints import between, first_contacts, footprint_corners, meeting_times, overlap
from unisim_blender.core.simulation.scores.driving import path_through
from unisim_blender.core.simulation.states import Footprint
from unisim_blender.core.world.polyline import Polyline

CAR = (10.0, 2.0, 4.0, 2.0, 0.0)


def box(*values: float) -> FloatArray:
    return np.array(values, np.float64)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (CAR, True),
        ((10.0, 2.0, 4.0, 2.0, np.pi), True),
        ((14.0, 2.0, 4.0, 2.0, 0.0), True),
        ((14.0, 4.0, 4.0, 2.0, 0.0), True),
        ((14.001, 2.0, 4.0, 2.0, 0.0), False),
        ((10.0, 4.001, 4.0, 2.0, 0.0), False),
        ((10.0, 2.0, 0.5, 0.5, 0.3), True),
        ((12.0 + np.sqrt(0.5) - 1e-6, 2.0, 1.0, 1.0, np.pi / 4), True),
        ((12.0 + np.sqrt(0.5) + 1e-6, 2.0, 1.0, 1.0, np.pi / 4), False),
        # within reach along the car's own axes, apart along the other's
        ((13.0, 4.0, 2.0, 2.0, np.pi / 4), False),
        ((1e6, 2.0, 4.0, 2.0, 0.0), False),
    ],
    ids=["itself", "backwards", "ends touch", "corners touch", "ends apart", "sides apart", "inside", "tip in",
         "tip out", "corner to edge", "far"],
)  # fmt: skip
def test_overlap(other: tuple[float, ...], expected: bool) -> None:
    assert overlap(box(*CAR), box(*other)) == expected
    assert overlap(box(*other), box(*CAR)) == expected


def test_a_box_without_a_length_is_an_edge() -> None:
    edge = box(12.0, 2.0, 0.0, 2.0, 0.0)
    assert overlap(edge, box(13.0, 3.0, 2.0, 2.0, 0.0))
    assert not overlap(edge, box(13.1, 3.0, 2.0, 2.0, 0.0))


@pytest.mark.parametrize(
    ("other", "velocity", "begin", "end"),
    [
        ((20.0, 2.0, 4.0, 2.0, 0.0), (-3.0, 0.0), 2.0, 14 / 3),
        ((10.0, 12.0, 4.0, 2.0, 0.0), (0.0, -4.0), 2.0, 3.0),
        # the square's tip is first: 10 - 2 - its half diagonal of sqrt(2)
        ((20.0, 2.0, 2.0, 2.0, np.pi / 4), (-1.0, 0.0), 8 - np.sqrt(2), 12 + np.sqrt(2)),
        # along x from 6/2 to 14/2, along y from 4/1 to 8/1
        ((20.0, 8.0, 4.0, 2.0, 0.0), (-2.0, -1.0), 4.0, 7.0),
        ((12.0, 2.0, 4.0, 2.0, 0.0), (-1.0, 0.0), -2.0, 6.0),
    ],
    ids=["along", "across", "tip", "diagonal", "overlapping"],
)
def test_meeting_times(other: tuple[float, ...], velocity: tuple[float, float], begin: float, end: float) -> None:
    found = meeting_times(box(*CAR), box(*other), box(*velocity))
    assert found[0] == pytest.approx(begin, abs=1e-8)
    assert found[1] == pytest.approx(end, abs=1e-8)


def test_boxes_that_do_not_move_meet_always_or_never() -> None:
    def meet(other: FloatArray, velocity: FloatArray) -> list[float]:
        return [float(time) for time in meeting_times(box(*CAR), other, velocity)]

    assert meet(box(14.0, 2.0, 4.0, 2.0, 0.0), box(0.0, 0.0)) == [-np.inf, np.inf]
    assert meet(box(14.1, 2.0, 4.0, 2.0, 0.0), box(0.0, 0.0)) == [np.inf, -np.inf]
    # past each other, sides 1 mm apart
    assert meet(box(30.0, 4.001, 4.0, 2.0, 0.0), box(-5.0, 0.0)) == [np.inf, -np.inf]


def test_meeting_times_are_those_at_which_boxes_begin_and_end_to_overlap() -> None:
    rng = np.random.default_rng([28, 1])
    a = np.concatenate([rng.uniform(-5, 5, (400, 2)), rng.uniform(0.5, 6, (400, 2)), rng.uniform(-4, 4, (400, 1))], 1)
    b = np.concatenate([rng.uniform(-15, 15, (400, 2)), rng.uniform(0.5, 6, (400, 2)), rng.uniform(-4, 4, (400, 1))], 1)
    velocity = rng.uniform(-9, 9, (400, 2))
    begin, end = meeting_times(a, b, velocity)
    times = np.linspace(-4, 4, 201)
    moved = np.repeat(b[None], len(times), 0)
    moved[..., :2] += times[:, None, None] * velocity
    inside = overlap(np.broadcast_to(a, moved.shape), moved)
    expected = (times[:, None] >= begin) & (times[:, None] <= end)
    sure = (np.abs(times[:, None] - begin) > 1e-6) & (np.abs(times[:, None] - end) > 1e-6)
    assert (inside == expected)[sure].all()
    assert 50 < np.isfinite(begin).sum() < 350


def test_corners_and_boxes_between() -> None:
    footprint = Footprint("a", "Car", 3.0, -2.0, 0.7, 4.0, 1.8, 0.0)
    assert footprint_corners(box(3.0, -2.0, 4.0, 1.8, 0.7)) == pytest.approx(footprint.corners, abs=1e-12)
    half = between(box(0, 0, 4, 2, 3.0), box(2, 4, 4, 2, -3.0), 0.5)
    assert half == pytest.approx([1, 2, 4, 2, np.pi], abs=1e-12)


def test_nothing_is_jumped_over_between_steps() -> None:
    # at 60 m/s and 10 Hz the bumpers leave gaps of 1.5 m, and the post stands in one
    times = np.arange(6) * 0.1
    ego = np.stack([box(60 * t, 0.0, 4.5, 2.0, 0.0) for t in times])
    post = np.broadcast_to(box(15.0, 0.0, 0.5, 0.5, 0.0), (6, 1, 5))
    assert not overlap(ego[:, None], post).any()
    assert first_contacts(times, ego, post, np.ones((6, 1), bool))[0] == pytest.approx(
        (15 - 0.25 - 2.25) / 60, abs=1e-9
    )


def test_first_contacts_of_what_turns_are_those_of_much_shorter_steps() -> None:
    times = np.arange(41) * 0.1
    turning = np.stack([np.array([8 * np.sin(t), 8 - 8 * np.cos(t), 4.5, 2.0, t]) for t in times])
    rng = np.random.default_rng([28, 2])
    others = np.empty((41, 60, 5))
    others[..., :2] = rng.uniform(-3, 14, (60, 2)) + times[:, None, None] * rng.uniform(-2, 2, (60, 2))
    others[..., 2:4] = rng.uniform(0.5, 4, (60, 2))
    others[..., 4] = rng.uniform(-3, 3, 60) + times[:, None] * rng.uniform(-1, 1, 60)
    found = first_contacts(times, turning, others, np.ones((41, 60), bool))
    fine = np.linspace(0, 4, 1601)
    step = np.minimum((fine / 0.1).astype(int), 39)
    part = fine / 0.1 - step
    ego = between(turning[step], turning[step + 1], part)
    moved = between(others[step], others[step + 1], part[:, None])
    met = overlap(ego[:, None], moved)
    expected = np.where(met.any(0), fine[met.argmax(0)], np.inf)
    both = np.isfinite(found) & np.isfinite(expected)
    # one graze of a centimetre may be seen by one of the two alone
    assert (np.isfinite(found) != np.isfinite(expected)).sum() <= 1
    assert 20 < both.sum() < 60
    assert np.abs(found[both] - expected[both]).max() < 0.02


def test_along_and_across_a_bent_path() -> None:
    path = path_through(np.array([[0.0, 0], [10, 0], [10, 10]]), 0.0, np.pi / 2)
    positions = np.array([[-2.0, 1], [3, 2], [8, -1], [11, 5], [9, 9], [10.5, 13]])
    along, across = path.follow(positions, 0.0)
    assert along == pytest.approx([-2, 3, 8, 15, 19, 23], abs=1e-12)
    assert across == pytest.approx([1, 2, -1, -1, 1, -0.5], abs=1e-12)
    assert path.length_m == pytest.approx(20)


def test_a_path_that_crosses_itself_is_followed() -> None:
    # a figure of eight through the origin, 20 m wide
    turn = np.linspace(0, 2 * np.pi, 400)
    eight = np.stack([20 * np.sin(turn), 20 * np.sin(turn) * np.cos(turn)], -1)
    path = path_through(eight, np.pi / 4, np.pi / 4)
    along, across = path.follow(eight[::4], 0.0)
    assert (np.diff(along) > 0).all()
    assert along[-1] == pytest.approx(path.along_m[396], abs=1e-9)
    assert np.abs(across).max() < 1e-9


@pytest.mark.parametrize("positions", [[[3.0, 4.0]], [[3.0, 4.0]] * 5, [[3.0, 4.0], [3.01, 4.0], [3.0, 4.01]]])
def test_a_path_of_standing_has_the_direction_of_its_heading(positions: list[list[float]]) -> None:
    path = path_through(np.array(positions), np.pi / 2, np.pi / 2)
    along, across = path.follow(np.array([[3.0, 4.0], [3.0, 9.0], [1.0, 9.0], [3.0, 2.0]]), 0.0)
    assert along == pytest.approx([0, 5, 5, -2], abs=1e-12)
    assert across == pytest.approx([0, 0, 2, 0], abs=1e-12)


def test_distances_to_a_line_through_points() -> None:
    line = np.array([[0.0, 0], [10, 0], [10, 10]])
    points = np.array([[5.0, 3], [-3, 4], [13, 14], [10, 5], [7, 4]])
    assert Polyline.through(line).distances(points) == pytest.approx([3, 5, 5, 0, 3], abs=1e-12)
    assert Polyline.through(line[:1]).distances(points)[1] == pytest.approx(5)
    assert Polyline.through(np.zeros((3, 2))).distances(points)[1] == pytest.approx(5)
