"""Scores of plans, and scores of scores, against cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from driven_record import FRONT, record_of, straight, times

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.simulation.scores.collision import Collisions, TimeToCollision, collisions, time_to_collision
from unisim_blender.core.simulation.scores.composite import alpasim_score, hd_score, pdms
from unisim_blender.core.simulation.scores.driving import (
    Comfort,
    RouteProgress,
    comfort,
    path_places,
    plan_consistency,
    progress,
)
from unisim_blender.core.simulation.scores.off_road import StaticCollision, off_road, static_collision
from unisim_blender.core.simulation.scores.record import PlanRecord, Record

FIVE = times(5.0)
CAR = (4.0, 2.0)
FAR = {"a": (straight(FIVE, 0, 50, 0, 0), CAR)}


def plan(made_s: float, positions: list[tuple[float, float]] | FloatArray, step_s: float = 0.5) -> PlanRecord:
    """A plan of positions in steps from ``made_s`` on, headings along x."""
    at = np.asarray(positions, np.float64)
    times_us = np.round((made_s + step_s * np.arange(1, len(at) + 1)) * 1e6).astype(np.int64)
    return PlanRecord(round(made_s * 1e6), times_us, np.concatenate([at, np.zeros((len(at), 1))], 1))


def ahead(made_s: float, start_x: float, speed: float, count: int, y: float = 0.0, step_s: float = 0.5) -> PlanRecord:
    """A plan of constant speed along x."""
    x = start_x + speed * step_s * np.arange(1, count + 1)
    return plan(made_s, np.stack([x, np.full(count, y)], -1), step_s)


def planned(*plans: PlanRecord, actors: dict[str, tuple[FloatArray, tuple[float, float]]] | None = None) -> Record:
    """A record of an ego at 10 m/s along x with plans."""
    return record_of(FIVE, straight(FIVE, 0, 0, 0, 10), FAR if actors is None else actors, plans=plans)


def test_plans_that_agree_are_consistent() -> None:
    found = plan_consistency(planned(*(ahead(t, 10 * t, 10, 12) for t in (0.0, 0.5, 1.0))))
    assert (found.mean_m, found.max_m, found.pairs) == pytest.approx((0, 0, 2), abs=1e-9)
    assert (found.end_point_mean_m, found.end_pairs) == pytest.approx((0, 2), abs=1e-9)


def test_near_positions_weigh_more() -> None:
    # at 1.5 and 2.0 s, half a second and a second after the later plan, they are 1 m and 3 m apart
    record = planned(plan(0.0, [(5, 0), (10, 0), (15, 0), (20, 0)]), plan(1.0, [(15, 1), (20, 3), (25, 99)]))
    near, late = np.exp(-0.5), np.exp(-1.0)
    assert plan_consistency(record).mean_m == pytest.approx((near * 1 + late * 3) / (near + late))
    assert plan_consistency(record).end_point_mean_m is None
    assert plan_consistency(record).reason == "no two successive plans reach 5 s ahead"


def test_the_end_point_is_that_five_seconds_after_the_later_plan() -> None:
    record = planned(ahead(0.0, 0, 10, 13), ahead(1.0, 10, 11, 11, y=2.0))
    assert plan_consistency(record).end_point_mean_m == pytest.approx(np.hypot(5.0, 2.0))


@pytest.mark.parametrize(
    ("plans", "reason"),
    [
        ((), "the driver gave no plans"),
        ((ahead(0, 0, 10, 4),), "the driver gave one plan alone"),
        ((ahead(0, 0, 10, 2), ahead(3, 30, 10, 2)), "no two successive plans share a time"),
    ],
)
def test_consistency_needs_two_plans_that_share_times(plans: tuple[PlanRecord, ...], reason: str) -> None:
    found = plan_consistency(planned(*plans))
    assert found.mean_m is None and found.reason == reason
    assert plan_consistency(record_of(FIVE, straight(FIVE, 0, 0, 0, 1))).reason == "the driver gave no plans"


def test_a_safe_comfortable_plan_has_all_of_the_hd_score() -> None:
    found = hd_score(planned(ahead(0.0, 0, 10, 6)), 0.5)
    assert (found.mean_of_plans, found.score, found.plans) == pytest.approx((1, 0.5, 1))
    assert found.left_out == ("drivable_area_compliance", "static_collision")


@pytest.mark.parametrize(
    ("gap_m", "expected"),
    [
        (-0.1, (0, 0, 1, 0.0)),  # the last planned box is in the car
        (4.9, (1, 0, 1, 2 / 7)),  # it gets there within half a second more
        (9.9, (1, 0, 1, 2 / 7)),  # and within a second
        (10.1, (1, 1, 1, 1.0)),
    ],
)
def test_a_plan_towards_a_car_that_stands(gap_m: float, expected: tuple[float, ...]) -> None:
    # three planned steps of 5 m
    car = {"a": (straight(FIVE, 15 + FRONT + gap_m + 2, 0, 0, 0), CAR)}
    found = hd_score(planned(ahead(0.0, 0, 10, 3), actors=car), 1.0)
    means = (found.no_collision_mean, found.time_to_collision_mean, found.comfort_mean, found.mean_of_plans)
    assert means == pytest.approx(expected)


def test_actors_are_where_they_are_at_the_planned_times() -> None:
    # it crosses the ego's lane between 1 and 2.2 s, where the plan is at 10 to 22 m
    crossing = {"a": (straight(FIVE, 16, 8, -np.pi / 2, 5), CAR)}
    assert hd_score(planned(ahead(0.0, 0, 10, 6), actors=crossing), 1.0).no_collision_mean == 0
    assert hd_score(planned(ahead(0.0, 0, 2.5, 6), actors=crossing), 1.0).no_collision_mean == 1
    # the same place once it has gone
    assert hd_score(planned(ahead(2.5, 25, 10, 4), actors=crossing), 1.0).no_collision_mean == 1


def test_a_harsh_plan_costs_its_comfort() -> None:
    stop = plan(0.0, [(5, 0), (10, 0), (10.1, 0), (10.2, 0)])
    found = hd_score(planned(stop), 1.0)
    assert (found.comfort_mean, found.mean_of_plans) == pytest.approx((0, 5 / 7))
    short = hd_score(planned(ahead(0.0, 0, 10, 2)), 1.0)
    assert (short.comfort_mean, short.plans) == (1, 1)


def test_what_the_hd_score_needs() -> None:
    assert hd_score(planned(), 1.0).reason == "the driver gave no plans"
    assert hd_score(planned(ahead(0, 0, 10, 4), actors={}), 1.0).reason == "no other actor was present"
    assert hd_score(planned(ahead(0, 0, 10, 4)), None).reason == "the route's completion is not known"
    for outside in (ahead(6, 60, 10, 4), ahead(1, 10, 10, 1)):
        assert "no plan was made within the rollout" in (hd_score(planned(outside), 1.0).reason or "")


def scores_of(record: Record) -> tuple[Collisions, TimeToCollision, Comfort, RouteProgress]:
    """What PDMS is made of."""
    found = collisions(record)
    return found, time_to_collision(record, found), comfort(record), progress(record, path_places(record))


def test_pdms_of_a_slow_drive() -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 5), FAR, log=straight(FIVE, 0, 0, 0, 10))
    found = pdms(*scores_of(record))
    assert found.score == pytest.approx((5 * 0.5 + 5 * 1 + 2 * 1) / 12)
    assert found.left_out[:2] == ("drivable_area_compliance", "driving_direction_compliance")
    assert all("lanes" in name for name in found.left_out[2:]) and len(found.left_out) == 4


def test_pdms_of_a_crash_is_nothing_and_of_a_near_one_less() -> None:
    car = {"a": (straight(FIVE, 40, 0, 0, 0), CAR)}
    crash = pdms(*scores_of(record_of(FIVE, straight(FIVE, 0, 0, 0, 10), car)))
    assert crash.score == 0 and crash.terms["ego_progress"] == 1
    near = record_of(FIVE[:31], straight(FIVE[:31], 0, 0, 0, 10), {"a": (straight(FIVE[:31], 40, 0, 0, 0), CAR)})
    assert pdms(*scores_of(near)).score == pytest.approx((5 + 0 + 2) / 12)


def test_a_score_of_scores_says_what_it_lacks() -> None:
    empty = pdms(*scores_of(record_of(FIVE, straight(FIVE, 0, 0, 0, 10))))
    assert empty.score is None
    assert "no time_to_collision_within_bound: no other actor was present" in (empty.reason or "")
    short = pdms(
        *scores_of(record_of(FIVE[:2], straight(FIVE[:2], 0, 0, 0, 10), {"a": (straight(FIVE[:2], 0, 9, 0, 0), CAR)}))
    )
    assert short.score is None and short.reason == "no comfort: jerk needs 3 steps, and there are 2"


@pytest.mark.parametrize(("speed", "expected"), [(4.0, 0.5), (8.0, 1.0), (12.0, 1.0)])
def test_alpasim_asks_for_four_fifths_of_the_distance(speed: float, expected: float) -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, speed), FAR, log=straight(FIVE, -9, 0, 0, 10))
    found, _, _, made = scores_of(record)
    score = alpasim_score(
        found, off_road(record, lambda points: points[:, 1] < 9), made, static_collision(record, None)
    )
    assert score.score == pytest.approx(expected)
    assert score.left_out == ("static_collision",)
    off = alpasim_score(found, off_road(record, lambda points: points[:, 1] > 9), made, static_collision(record, None))
    assert off.score == 0


def test_alpasim_counts_the_static_scene_where_it_was_looked_for() -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 10), FAR, log=straight(FIVE, -9, 0, 0, 14))
    found, _, _, made = scores_of(record)
    road = off_road(record)
    hit = StaticCollision(True, 2.0, 3, 40, False)
    assert alpasim_score(found, road, made, hit).score == 0
    free = alpasim_score(found, road, made, StaticCollision(False, None, 0, 0, False))
    assert free.score and free.left_out == ("road_map",)
