"""Which box is in the way, how far it is, and whether two boxes are about to meet."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_traffic import bend, keys, straight

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.simulation.actors.lead import Lead, Search, find_leads, separations, swept
from unisim_blender.core.simulation.footprints import time_to_overlap, times_to_overlap
from unisim_blender.core.simulation.states import Footprint, FootprintArrays, Traffic
from unisim_blender.core.world.actor_path import ActorPath

LENGTH, WIDTH = 4.0, 2.0
TURNED = np.array([[0, 0, 0, 1], [0, 0, 1, 0], [0, -1, 0, 0], [-1, 0, 0, 0.0]])
"""Times it on the right, a quaternion is turned by half a turn about its own z."""
DRAWN = ((-15, 15), (-15, 15), (-4, 4), (0.5, 8), (0.5, 8), (0, 20))
"""Ends of a random box's values."""


def box(
    x: float, y: float, heading: float = 0.0, length: float = 4.0, width: float = 2.0, speed: float = 0.0,
    uid: str = "other",
) -> Footprint:  # fmt: skip
    return Footprint(uid, "Car", x, y, heading, length, width, speed)


def lead(*boxes: Footprint, horizon: float = 60.0, bent: bool = False, ignored: tuple[str, ...] = ()) -> Lead | None:
    """What is in the way of a box of 4 by 2 m at the origin that drives along x, or along an arc to the left."""
    trajectory = bend(keys(10), 0, 0, 10.0, 0.5) if bent else straight(keys(10), 0, 0, 10.0)
    path = ActorPath.recorded(trajectory, 0.0, 10.0, False)
    assert path is not None
    own = box(0, 0, uid="own")
    search = Search(path, 0.0, horizon, 1.0, "own", LENGTH, WIDTH, ignored)
    return find_leads([search], Traffic(0, (*boxes, own)))[0]


def plain_lead(search: Search, traffic: Traffic) -> Lead | None:
    """What `find_leads` returns, box by box and pose by pose."""
    sweep, half = swept([search]), (search.length_m / 2, search.width_m / 2)
    (gear,) = sweep.gear.tolist()

    def apart(x: float, y: float, heading: float, other: int) -> float:
        at_x, at_y, turned = (np.array([value]) for value in (x, y, heading))
        return float(separations(at_x, at_y, turned, half, traffic.boxes, np.array([other]))[0, 0])

    others = [
        index for index, one in enumerate(traffic.footprints) if one.uid != search.uid and one.uid not in search.ignored
    ]
    poses = list(zip(sweep.x_m.tolist(), sweep.y_m.tolist(), sweep.heading_rad.tolist(), strict=True))
    x, y, heading = poses[0]
    for index in list(others):
        other = traffic.footprints[index]
        ahead = (other.x_m - x) * math.cos(heading) + (other.y_m - y) * math.sin(heading)
        if apart(x, y, heading, index) <= 0 and ahead * gear <= 0:
            others.remove(index)
    for row, pose in enumerate(poses):
        met = [index for index in others if apart(*pose, index) <= 0]
        found = []
        for index in met:
            other = traffic.footprints[index]
            gap = apart(*pose, index)
            if row:
                low, high = 0.0, 1.0
                for _ in range(40):
                    u = (low + high) / 2
                    x, y, heading = (a + u * (b - a) for a, b in zip(poses[row - 1], pose, strict=True))
                    low, high = (u, high) if apart(x, y, heading, index) > 0 else (low, u)
                gap = (row - 1 + high) * search.step_m
            found.append(Lead(other.uid, gap, other.speed_m_s * math.cos(other.heading_rad - pose[2]) * gear))
        if found:
            return min(found, key=lambda one: one.gap_m)
    return None


@pytest.mark.parametrize("seed", range(4))
def test_all_leads_at_once_are_those_of_each(seed: int) -> None:
    """In dense traffic, some of it overlapping, along bends, backward and for boxes that are ignored."""
    rng = np.random.default_rng([28, seed])
    boxes, searches = [], []
    for number in range(40):
        x, y, heading = (float(rng.uniform(-low, low)) for low in (40, 40, 3.1))
        length, width, speed = (float(rng.uniform(*ends)) for ends in ((0.3, 9), (0.3, 3), (0, 15)))
        boxes.append(box(x, y, heading, length, width, speed, uid=f"{number}"))
        path = ActorPath.recorded(
            bend(keys(8), x, y, float(rng.uniform(2, 9)), float(rng.uniform(-0.5, 0.5)), heading), 0, 8, False
        )
        assert path is not None
        if number % 7 == 0:  # backward
            path = replace(path, quaternions_wxyz=path.quaternions_wxyz @ TURNED)
        ignored = tuple(f"{one}" for one in rng.integers(40, size=3))
        s, horizon = float(rng.uniform(0, 10)) if number % 3 == 0 else 0.0, float(rng.uniform(1, 70))
        searches.append(Search(path, s, horizon, float(rng.uniform(0.3, 1.5)), f"{number}", length, width, ignored))
    traffic = Traffic(0, tuple(boxes))
    found = find_leads(searches, traffic)
    wanted = [plain_lead(one, traffic) for one in searches]
    assert [one and one.uid for one in found] == [one and one.uid for one in wanted]
    assert 10 < sum(one is not None for one in wanted) < 40
    for one, other in zip(found, wanted, strict=True):
        if one is not None and other is not None:
            assert one.gap_m == pytest.approx(other.gap_m, abs=0.02)  # it may graze
            assert one.speed_m_s == pytest.approx(other.speed_m_s, abs=1e-9)
    alone = [find_leads([one], traffic)[0] for one in searches]
    assert alone == found


def is_lead(found: Lead | None, gap_m: float, speed_m_s: float) -> bool:
    """Whether the box "other" was found, this far ahead and this fast."""
    assert found is not None and found.uid == "other"
    return abs(found.gap_m - gap_m) <= 2e-3 and abs(found.speed_m_s - speed_m_s) <= 1e-9


@pytest.mark.parametrize("x", [4.3, 10.0, 33.37, 59.9])
def test_the_gap_is_from_bumper_to_bumper(x: float) -> None:
    found = lead(box(x, 0.3, speed=7.0))
    assert is_lead(found, x - 4.0, 7.0)


def test_a_box_beside_the_lane_is_none() -> None:
    assert lead(box(20, 2.01)) is None
    assert lead(box(20, -2.01)) is None
    assert lead(box(-4.5, 0)) is None
    assert lead(box(100, 0)) is None


def test_a_box_whose_corner_reaches_in_leads() -> None:
    """Turned by 0.4 rad, its corners reach further aside than its middle's distance tells."""
    reach = 2 * math.sin(0.4) + math.cos(0.4)
    found = lead(box(20, 1.0 + reach - 0.05, 0.4))
    assert found is not None
    rear_right = 20 - 2 * math.cos(0.4) + math.sin(0.4)  # the corner that is nearest to the lane
    assert found.gap_m == pytest.approx(rear_right - 2.0, abs=0.15)
    assert lead(box(20, 1.0 + reach + 0.05, 0.4)) is None


def test_a_crossing_box_leads_though_none_of_its_corners_is_in_the_lane() -> None:
    """A bus across the lane: at no speed along it."""
    found = lead(box(30, 1.0, math.pi / 2, length=12.0, width=2.5, speed=8.0))
    assert is_lead(found, 30 - 1.25 - 2.0, 0.0)


def test_a_box_that_comes_towards_it() -> None:
    found = lead(box(30, 0.0, math.pi, speed=8.0))
    assert is_lead(found, 26.0, -8.0)


def test_the_nearest_of_several_and_those_that_are_ignored() -> None:
    boxes = box(40, 0, uid="far"), box(20, 0.5, uid="near"), box(10, 4, uid="beside")
    assert getattr(lead(*boxes), "uid", None) == "near"
    assert getattr(lead(*boxes, ignored=("near",)), "uid", None) == "far"
    assert lead(*boxes, ignored=("near", "far")) is None


def test_a_thin_box_is_not_stepped_over() -> None:
    """A post, for every place of it within a step of the sweep."""
    for x in np.arange(20.0, 21.0, 0.07):
        found = lead(box(float(x), 0.9, length=0.1, width=0.1))
        assert found is not None and found.gap_m == pytest.approx(x - 0.05 - 2.0, abs=5e-3)


def test_boxes_that_overlap_already() -> None:
    """The one ahead is in the way of the one behind, by a negative gap, and not the other way round."""
    ahead = lead(box(3.0, 0.0))
    assert is_lead(ahead, -1.0, 0.0)
    assert lead(box(-3.0, 0.0)) is None


def test_along_a_bend() -> None:
    """Straight ahead there is nothing in the way; on the arc of 20 m radius there is."""
    assert lead(box(45, 0), bent=True) is None
    at = 1.2
    found = lead(box(20 * math.sin(at), 20 * (1 - math.cos(at)), at), bent=True)
    assert found is not None and found.gap_m == pytest.approx(20 * at - 4.0, abs=0.3)
    # the outer front corner swings out: half the diagonal beside the arc, it touches what a band of its width would not
    reach = math.hypot(20 + 1, 2)
    angle = math.pi / 2
    post = box(reach * 0.999 * math.sin(angle), 20 - reach * 0.999 * math.cos(angle), length=0.02, width=0.02)
    assert reach - 21 > 0.09 and lead(post, bent=True) is not None
    off = replace(post, x_m=(reach + 0.03) * math.sin(angle))
    assert lead(off, bent=True) is None


@given(st.tuples(*[st.floats(-6, 6)] * 2, *[st.floats(-4, 4)] * 2, *[st.floats(0.2, 6)] * 4))
@settings(max_examples=200, deadline=None)
def test_separation_tells_whether_points_are_shared(values: tuple[float, ...]) -> None:
    """Against points of one box that lie in the other."""
    x, y, own, turned, length, width, other_length, other_width = values
    a, b = box(0, 0, own, length, width), box(x, y, turned, other_length, other_width)
    one = np.zeros(1)
    apart = float(
        separations(one, one, np.array([own]), (length / 2, width / 2), Traffic(0, (b,)).boxes, np.array([0]))[0, 0]
    )
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 41), np.linspace(-0.5, 0.5, 41)), -1).reshape(-1, 2)
    local = grid * [length, width]
    points = local @ np.array([[math.cos(own), math.sin(own)], [-math.sin(own), math.cos(own)]])
    cos, sin = math.cos(b.heading_rad), math.sin(b.heading_rad)
    inside = (points - [x, y]) @ np.array([[cos, -sin], [sin, cos]])
    shared = bool((np.abs(inside) <= [other_length / 2, other_width / 2]).all(1).any())
    if shared:
        assert apart <= 1e-9
    if apart < -0.3 and not shared:  # overlap deeper than the grid is fine must be found by it
        assert min(length, width, other_length, other_width) < 0.5
    assert a.length_m == length


def test_when_two_boxes_meet() -> None:
    """Head on, one behind the other, crossing just before and just behind; worked by hand."""
    own = box(0, 0, speed=10.0)
    assert time_to_overlap(own, box(34, 0, math.pi, speed=5.0), 3.0) == pytest.approx(2.0)
    assert time_to_overlap(own, box(14, 0, speed=5.0), 3.0) == pytest.approx(2.0)
    assert time_to_overlap(own, box(14, 0, speed=5.0), 1.9) is None
    assert time_to_overlap(own, box(14, 0, speed=12.0), 100.0) is None
    assert time_to_overlap(own, box(14, 2.01), 100.0) is None
    assert time_to_overlap(own, box(3, 0), 3.0) == 0.0
    # one that crosses from the right at 10 m/s: its front is at the lane's edge after (y - 2 - 1) / 10 s
    crossing = box(20, -18, math.pi / 2, speed=10.0)
    assert time_to_overlap(own, crossing, 3.0) == pytest.approx(1.7)  # ours is there from 1.7 s, it from 1.5 to 2.1 s
    assert time_to_overlap(own, replace(crossing, y_m=-25.0), 3.0) == pytest.approx(2.2)
    assert time_to_overlap(own, replace(crossing, y_m=-35.0), 3.0) is None
    assert time_to_overlap(own, replace(crossing, y_m=-5.0), 3.0) is None


@given(st.integers(0, 10**6))
@settings(max_examples=100, deadline=None)
def test_when_two_boxes_meet_against_small_steps(seed: int) -> None:
    rng = np.random.default_rng(seed)

    def drawn() -> Footprint:
        x, y, heading, length, width, speed = (float(rng.uniform(*ends)) for ends in DRAWN)
        return box(x, y, heading, length, width, speed)

    a, b = drawn(), drawn()
    found = time_to_overlap(a, b, 3.0)
    t = np.linspace(0, 3, 1501)
    vx = a.speed_m_s * math.cos(a.heading_rad) - b.speed_m_s * math.cos(b.heading_rad)
    vy = a.speed_m_s * math.sin(a.heading_rad) - b.speed_m_s * math.sin(b.heading_rad)
    half, other = (a.length_m / 2, a.width_m / 2), Traffic(0, (b,)).boxes
    headings = np.full(len(t), a.heading_rad)
    apart = separations(a.x_m + vx * t, a.y_m + vy * t, headings, half, other, np.array([0]))[:, 0]
    first = float(t[int(np.argmax(apart <= 0))]) if (apart <= 0).any() else None
    if first is not None:
        assert found is not None and first - 0.0021 <= found <= first + 1e-9
    if found is None:
        assert first is None


def test_a_value_that_is_not_finite_is_one_sentence() -> None:
    with pytest.raises(UnisimError, match=r'^traffic at 0 us: "other" has speed_m_s nan, which is not finite$'):
        lead(box(10, 0, speed=math.nan))


def test_overlaps_within_a_horizon_are_those_of_all_pairs() -> None:
    """Most pairs are left out, by circles about the boxes."""
    rng = np.random.default_rng(5)

    def boxes(count: int) -> FootprintArrays:
        values = rng.uniform((-60, -60, -4, 2, 1, 0), (60, 60, 4, 8, 3, 20), (count, 6))
        values[::5, 5] = 0.0
        return Traffic(0, tuple(box(*row) for row in values.tolist())).boxes

    def footprint(of: FootprintArrays, index: int) -> Footprint:
        length, width = 2 * float(of.half_length_m[index]), 2 * float(of.half_width_m[index])
        place = float(of.x_m[index]), float(of.y_m[index])
        return box(*place, float(of.heading_rad[index]), length, width, float(of.speed_m_s[index]))

    some, others = boxes(40), boxes(30)
    every = times_to_overlap(some, others)
    for horizon_s in (0.0, 1.0, 3.0, 20.0):
        found = times_to_overlap(some, others, horizon_s)
        within = every <= horizon_s
        assert (found[within] == every[within]).all() and (found[~within] > horizon_s).all()
        assert within.sum() > 0 or horizon_s < 1
    assert np.isfinite(every).sum() < every.size / 2
    for i in range(40):
        for j in range(30):
            one = time_to_overlap(footprint(some, i), footprint(others, j), 20.0)
            assert (math.inf if one is None else one) == pytest.approx(every[i, j] if every[i, j] <= 20 else math.inf)
