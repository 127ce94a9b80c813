"""Collisions, times to collision and stars against cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from driven_record import FRONT, REAR, record_of, straight, times

from unisim_blender.core.simulation.scores.collision import (
    collisions,
    ncap_stars,
    time_to_collision,
    times_to_collision,
)

FIVE = times(5.0)
CAR = (4.0, 2.0)


def test_driving_into_a_car_that_stands() -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 10), {"a": (straight(FIVE, 30, 0, 0, 0), CAR)})
    (contact,) = collisions(record).contacts or ()
    assert contact.time_s == pytest.approx((30 - 2 - FRONT) / 10, abs=1e-8)
    assert contact.relative_speed_m_s == pytest.approx(10)
    assert (contact.actor, contact.label, contact.side, contact.kind) == ("a", "Car", "front", "stopped_actor")
    assert contact.at_fault and not contact.at_start
    assert collisions(record).no_at_fault_collision == 0


def test_being_hit_from_behind() -> None:
    behind = {"b": (straight(FIVE, -20, 0, 0, 15), CAR)}
    standing = record_of(FIVE, straight(FIVE, 0, 0, 0, 0), behind)
    (contact,) = collisions(standing).contacts or ()
    assert contact.time_s == pytest.approx((20 - 2 + REAR) / 15, abs=1e-8)
    assert (contact.side, contact.kind, contact.at_fault) == ("rear", "stopped_ego", False)
    moving = record_of(FIVE, straight(FIVE, 0, 0, 0, 5), behind)
    (contact,) = collisions(moving).contacts or ()
    assert contact.time_s == pytest.approx((20 - 2 + REAR) / 10, abs=1e-8)
    assert contact.relative_speed_m_s == pytest.approx(10)
    assert (contact.side, contact.kind, contact.at_fault) == ("rear", "active_rear", False)
    assert collisions(moving).no_at_fault_collision == 1


def test_oncoming_traffic_hits_the_front() -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 8), {"c": (straight(FIVE, 40, 0, np.pi, 12), CAR)})
    (contact,) = collisions(record).contacts or ()
    assert contact.time_s == pytest.approx((40 - 2 - FRONT) / 20, abs=1e-8)
    assert contact.relative_speed_m_s == pytest.approx(20)
    assert (contact.side, contact.kind, contact.at_fault) == ("front", "active_front", True)


def test_a_bicycle_rides_into_the_side() -> None:
    bicycle = {"d": (straight(FIVE, 36, 20, -np.pi / 2, 5), (2.0, 0.6))}
    (contact,) = collisions(record_of(FIVE, straight(FIVE, 0, 0, 0, 10), bicycle)).contacts or ()
    assert contact.time_s == pytest.approx((20 - 1 - 1) / 5, abs=1e-8)
    assert contact.relative_speed_m_s == pytest.approx(np.sqrt(125))
    assert (contact.side, contact.kind, contact.at_fault) == ("side", "active_side", True)


def test_a_corner_of_the_rear_bumper_is_hit_from_behind_without_fault() -> None:
    # 1.5 m aside, so the centre is 135 degrees off the heading and not behind by the angle
    actor = {"e": (straight(FIVE, -10, 1.5, 0, 9), (1.0, 1.5))}
    (contact,) = collisions(record_of(FIVE, straight(FIVE, 0, 0, 0, 5), actor)).contacts or ()
    assert (contact.side, contact.kind, contact.at_fault) == ("rear", "active_side", False)


def test_boxes_that_touch_have_met_and_a_hair_between_them_keeps_them_apart() -> None:
    ego = straight(FIVE, 0, 0, 0, 7)
    beside = collisions(record_of(FIVE, ego, {"a": (straight(FIVE, 0, 2.0, 0, 7), CAR)})).contacts
    assert beside and beside[0].at_start and not beside[0].at_fault
    assert collisions(record_of(FIVE, ego, {"a": (straight(FIVE, 0, 2.000001, 0, 7), CAR)})).contacts == ()
    assert collisions(record_of(FIVE, ego, {"a": (straight(FIVE, 0, 2.0, 0, 7), CAR)})).no_at_fault_collision == 1


def test_each_actor_counts_once_in_the_order_of_time() -> None:
    actors = {
        "z": (straight(FIVE, 20, 0, 0, 0), CAR),
        "a": (straight(FIVE, 40, 0, 0, 0), CAR),
        "m": (straight(FIVE, 20, 9, 0, 0), CAR),
    }
    found = collisions(record_of(FIVE, straight(FIVE, 0, 0, 0, 10), actors)).contacts or ()
    assert [contact.actor for contact in found] == ["z", "a"]
    assert [contact.time_s for contact in found] == pytest.approx([1.475, 3.475], abs=1e-8)


def test_an_absent_actor_is_not_met() -> None:
    motion = straight(FIVE, 20, 0, 0, 0)
    motion[5:30] = np.nan  # the ego drives through its place between 1.475 and 2.325 s
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 10), {"a": (motion, CAR)})
    assert collisions(record).contacts == ()
    motion[23] = (20, 0, 0, 0)
    (contact,) = collisions(record_of(FIVE, straight(FIVE, 0, 0, 0, 10), {"a": (motion, CAR)})).contacts or ()
    assert contact.time_s == pytest.approx(2.3)


@pytest.mark.parametrize(
    ("label", "classes", "expected"),
    [("Cones", {}, 0.5), ("Car", {}, 0.0), ("never heard of", {}, 0.0), ("crate", {"crate": "still"}, 0.5)],
)
def test_objects_cost_half(label: str, classes: dict[str, str], expected: float) -> None:
    actor = {"a": (straight(FIVE, 20, 0, 0, 0), (0.5, 0.5))}
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 10), actor, label=label, classes=classes)
    assert collisions(record).no_at_fault_collision == expected


def test_without_actors_there_is_nothing_to_say() -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 10))
    found = collisions(record)
    assert found.contacts is None and found.no_at_fault_collision is None
    assert found.reason == time_to_collision(record, found).reason == "no other actor was present"
    assert ncap_stars(record, found).stars is None


@pytest.mark.parametrize(
    ("ego_speed", "other", "size", "expected"),
    [
        (10, (40, 0, 0, 6), CAR, (40 - 2 - FRONT) / 4),
        (10, (40, 0, np.pi, 10), CAR, (40 - 2 - FRONT) / 20),
        (10, (40, 0, 0, 10), CAR, np.inf),
        (10, (40, 0, 0, 12), CAR, np.inf),
        (10, (40, 2.1, np.pi, 10), CAR, np.inf),
        # the car crosses the ego's lane from 27/5 to 33/5 s: the ego is there, gets there, and comes too late
        (3.5, (20, 30, -np.pi / 2, 5), CAR, 27 / 5),
        (2.7, (20, 30, -np.pi / 2, 5), CAR, (20 - 1 - FRONT) / 2.7),
        (2.0, (20, 30, -np.pi / 2, 5), CAR, np.inf),
        # a box turned by 45 degrees, its corner first
        (4, (30, 0, np.pi / 4, 0), (2.0, 2.0), (30 - np.sqrt(2) - FRONT) / 4),
        (60, (400, 0, np.pi, 60), CAR, (400 - 2 - FRONT) / 120),
        (10, (5, 0, 0, 10), CAR, 0.0),
        (0, (40, 0, 0, 0), CAR, np.inf),
    ],
    ids=["catches up", "head on", "same speed", "faster lead", "passes by", "crossing", "crossing later", "too late",
         "turned", "60 m/s", "overlapping", "all stand"],
)  # fmt: skip
def test_time_to_collision_at_the_first_step(
    ego_speed: float, other: tuple[float, float, float, float], size: tuple[float, float], expected: float
) -> None:
    one = np.zeros(1)
    record = record_of(one, straight(one, 0, 0, 0, ego_speed), {"a": (straight(one, *other), size)})
    assert times_to_collision(record)[0, 0] == pytest.approx(expected, abs=1e-8)


def test_the_least_time_to_collision_and_when_it_falls_below_the_bound() -> None:
    ego = straight(FIVE, 0, 0, 0, 10)
    record = record_of(
        FIVE, ego, {"far": (straight(FIVE, 90, 0, 0, 0), CAR), "near": (straight(FIVE, 28, 0, 0, 6), CAR)}
    )
    found = time_to_collision(record, collisions(record))
    # the gap of 22.75 m closes at 4 m/s
    assert found.actor == "near" and found.minimum_at_s == pytest.approx(5.0)
    assert found.minimum_s == pytest.approx(22.75 / 4 - 5, abs=1e-8)
    assert found.within_bound is False
    assert found.below_bound_at_s == pytest.approx(4.7)


def test_who_does_not_count() -> None:
    behind = {"b": (straight(FIVE, -30, 0, 0, 15), CAR)}
    moving = record_of(FIVE[:11], straight(FIVE[:11], 0, 0, 0, 10), {"b": (straight(FIVE[:11], -30, 0, 0, 15), CAR)})
    found = time_to_collision(moving, collisions(moving))
    assert found.minimum_s is None and found.within_bound is True
    assert found.reason == "no actor was on a collision course that the ego has to answer for"
    assert found.minimum_of_all_s == pytest.approx((30 - 2 + REAR) / 5 - 1, abs=1e-8)
    standing = record_of(FIVE, straight(FIVE, 0, 0, 0, 0), {"a": (straight(FIVE, 30, 0, np.pi, 5), CAR)})
    assert time_to_collision(standing, collisions(standing)).within_bound is True
    # once it has been run into, the ego need not mind that actor any more, even ahead of its axle
    pushed = record_of(FIVE, straight(FIVE, 0, 0, 0, 10), behind)
    assert time_to_collision(pushed, collisions(pushed)).within_bound is True


def test_braking_to_half_the_speed_keeps_two_stars() -> None:
    # 10 m/s, 2.5 m/s^2: after 2 s and 15 m the ego still has 5 m/s
    ego = np.stack([10 * FIVE - 1.25 * FIVE**2, 0 * FIVE, 0 * FIVE, 10 - 2.5 * FIVE], -1)
    record = record_of(FIVE[:31], ego[:31], {"a": (straight(FIVE[:31], 15 + 2 + FRONT, 0, 0, 0), CAR)})
    found = ncap_stars(record, collisions(record))
    assert found.impact_speed_m_s == pytest.approx(5.0, abs=1e-6)
    assert found.reference_speed_m_s == pytest.approx(10.0)
    assert found.stars == pytest.approx(2.0, abs=1e-6)
    assert ncap_stars(record, collisions(record), 20.0).stars == pytest.approx(3.0, abs=1e-6)
    assert ncap_stars(record, collisions(record), 4.0).stars == 0.0


def test_five_stars_without_a_collision_and_none_without_a_speed_to_compare_with() -> None:
    free = record_of(FIVE, straight(FIVE, 0, 0, 0, 10), {"a": (straight(FIVE, 20, 9, 0, 0), CAR)})
    assert ncap_stars(free, collisions(free)).stars == 5.0
    # it steered into a car that its first velocity would have missed
    swerve = straight(FIVE, 0, 0, 0, 10)
    swerve[:, 1] = np.clip(FIVE - 1, 0, 3)
    record = record_of(FIVE, swerve, {"a": (straight(FIVE, 40, 3, 0, 0), CAR)})
    found = ncap_stars(record, collisions(record))
    assert found.stars is None and found.impact_speed_m_s == pytest.approx(10)
    assert found.reason and "would not have met actor a" in found.reason
    assert ncap_stars(record, collisions(record), 0.0).stars is None
