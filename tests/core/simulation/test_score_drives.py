"""Comfort, progress, deviation, the static scene, the road and unsupported pixels against cases worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from driven_record import FRONT, LENGTH, REAR, record_of, straight, times, trajectory

from unisim_blender.core.geometry import BoolArray, FloatArray
from unisim_blender.core.simulation.scores.driving import comfort, deviation, path_places, progress, rates
from unisim_blender.core.simulation.scores.off_road import corridor_distance, off_road, static_collision
from unisim_blender.core.simulation.scores.record import Record, RecordError
from unisim_blender.core.simulation.scores.summary import score_table, summarise, unsupported, validity

FIVE = times(5.0)


def speeding(times_s: FloatArray, speeds: FloatArray, headings: FloatArray | float = 0.0) -> Record:
    """A record whose speeds and headings alone matter."""
    motion = np.zeros((len(times_s), 4))
    motion[:, 2], motion[:, 3] = headings, speeds
    return record_of(times_s, motion)


def test_rates_of_uneven_steps_are_exact_where_they_can_be() -> None:
    uneven = np.array([0.0, 0.1, 0.35, 0.5, 0.9, 1.0])
    found = rates(uneven, 3 + uneven + 0.5 * uneven**2, 0.2 * uneven - 0.3 * uneven**2)
    middle = (uneven[1:] + uneven[:-1]) / 2
    assert found["longitudinal_acceleration_m_s2"] == pytest.approx(1 + middle)
    assert found["longitudinal_jerk_m_s3"] == pytest.approx(np.ones(4))
    assert found["yaw_rate_rad_s"] == pytest.approx(0.2 - 0.6 * middle)
    assert found["yaw_acceleration_rad_s2"] == pytest.approx(np.full(4, -0.6))


def test_a_circle_has_a_lateral_acceleration_and_no_jerk_even_where_headings_wrap() -> None:
    found = comfort(speeding(FIVE, np.full(51, 8.0), (3.0 + 0.5 * FIVE + np.pi) % (2 * np.pi) - np.pi))
    assert found.ranges is not None and found.comfortable
    assert found.ranges["yaw_rate_rad_s"].least == pytest.approx(0.5)
    assert found.ranges["lateral_acceleration_m_s2"].greatest == pytest.approx(4.0)
    assert found.ranges["jerk_m_s3"].greatest == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("acceleration", "comfortable"), [(2.40, True), (2.41, False), (-4.05, True), (-4.06, False), (0.0, True)]
)
def test_a_value_at_its_limit_is_comfortable(acceleration: float, comfortable: bool) -> None:
    found = comfort(speeding(FIVE, 30 + acceleration * FIVE))
    assert found.comfortable is comfortable
    assert found.ranges is not None
    assert {name for name, one in found.ranges.items() if not one.within} == (
        set() if comfortable else {"longitudinal_acceleration_m_s2"}
    )


def test_each_quantity_has_its_own_limit() -> None:
    jolt = np.where(FIVE > 2.45, 10.05, 10.0)  # 0.5 m/s^2 for a step: a jerk of 5 m/s^3
    found = comfort(speeding(FIVE, jolt)).ranges or {}
    assert [name for name, one in found.items() if not one.within] == ["longitudinal_jerk_m_s3"]
    assert found["longitudinal_jerk_m_s3"].least == pytest.approx(-5)
    spin = comfort(speeding(FIVE, np.full(51, 1.0), 1.0 * FIVE)).ranges or {}
    assert [name for name, one in spin.items() if not one.within] == ["yaw_rate_rad_s"]
    bend = comfort(speeding(FIVE, np.full(51, 10.0), 0.5 * FIVE)).ranges or {}
    assert [name for name, one in bend.items() if not one.within] == ["lateral_acceleration_m_s2"]
    weave = comfort(speeding(FIVE, np.full(51, 0.5), np.where(FIVE > 2.45, 0.05, 0.0))).ranges or {}
    assert [name for name, one in weave.items() if not one.within] == ["yaw_acceleration_rad_s2"]


@pytest.mark.parametrize("steps", [1, 2])
def test_comfort_needs_three_steps(steps: int) -> None:
    found = comfort(speeding(FIVE[:steps], np.zeros(steps)))
    assert (found.comfortable, found.ranges) == (None, None)
    assert found.reason == f"jerk needs 3 steps, and there are {steps}"


def winding(times_s: FloatArray, speed: float) -> FloatArray:
    """Motion along a bent road at constant speed, by small straight pieces."""
    heading = 0.4 * np.sin(0.15 * speed * times_s)
    step = np.diff(times_s, prepend=0.0) * speed
    return np.stack(
        [np.cumsum(step * np.cos(heading)), np.cumsum(step * np.sin(heading)), heading, 0 * heading + speed], -1
    )


def test_the_log_itself_makes_all_the_progress_and_does_not_deviate() -> None:
    record = record_of(FIVE, winding(FIVE, 9.0))
    places = path_places(record)
    made, away = progress(record, places), deviation(record, places)
    assert made.share == 1 and made.distance_m == made.recorded_distance_m
    assert made.recorded_distance_m == pytest.approx(45)
    assert (away.along_max_m, away.across_max_m) == pytest.approx((0, 0), abs=1e-9)


def test_half_the_speed_is_half_the_progress() -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 5), log=straight(FIVE, 0, 0, 0, 10))
    places = path_places(record)
    made, away = progress(record, places), deviation(record, places)
    assert (made.share, made.distance_m, made.recorded_distance_m) == pytest.approx((0.5, 25, 50))
    assert (away.along_max_m, away.along_mean_m, away.along_last_m) == pytest.approx((25, 12.5, -25))
    assert (away.across_max_m, away.across_last_m) == pytest.approx((0, 0), abs=1e-12)


def test_faster_than_the_log_is_all_the_progress_there_is() -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 12), log=straight(FIVE, 0, 0, 0, 10))
    made = progress(record, path_places(record))
    assert (made.share, made.distance_m) == pytest.approx((1, 60))
    assert deviation(record, path_places(record)).along_last_m == pytest.approx(10)


@pytest.mark.parametrize(("speed", "share"), [(0.99, 1.0), (1.01, 0.0)])
def test_progress_counts_from_five_recorded_metres(speed: float, share: float) -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 0), log=straight(FIVE, 0, 0, 0, speed))
    assert progress(record, path_places(record)).share == share


def test_a_lane_aside_is_across_and_a_length_ahead_is_along() -> None:
    ego = straight(FIVE, 7.0, 3.5, 0, 10)
    found = deviation(record := record_of(FIVE, ego, log=straight(FIVE, 2.0, 0, 0, 10)), path_places(record))
    assert (found.along_mean_m, found.along_max_m, found.along_last_m) == pytest.approx((5, 5, 5))
    assert (found.across_mean_m, found.across_last_m) == pytest.approx((3.5, 3.5))
    log = winding(fine := times(5.0, 0.02), 9.0)
    aside = log.copy()
    aside[:, 0] += 2 * np.sin(log[:, 2])
    aside[:, 1] -= 2 * np.cos(log[:, 2])
    found = deviation(record := record_of(fine, aside, log=log), path_places(record))
    assert found.across_last_m == pytest.approx(-2, abs=0.001)
    # the log's last piece and the next, where the bend's inside is: 2 m times a step's turn of 0.01 rad, twice
    assert found.along_max_m == pytest.approx(0, abs=0.05)


def test_what_was_not_recorded_is_not_compared() -> None:
    log = trajectory(FIVE[:21], straight(FIVE[:21], 0, 0, 0, 10))
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 10), recorded_ego=log)
    places = path_places(record)
    assert deviation(record, places).along_max_m == pytest.approx(0, abs=1e-9)
    made = progress(record, places)
    assert (made.share, made.distance_m, made.recorded_distance_m) == pytest.approx((1, 50, 20))
    late = record_of(FIVE + 9, straight(FIVE, 0, 0, 0, 10), recorded_ego=log)
    assert progress(late, path_places(late)).share is None
    assert deviation(late, path_places(late)).reason == "no step lies within the log's times"


def test_a_rollout_may_begin_anywhere_in_the_log() -> None:
    log = trajectory(FIVE, winding(FIVE, 9.0))
    part = slice(20, 41)
    record = record_of(FIVE[part], winding(FIVE, 9.0)[part], recorded_ego=log)
    made = progress(record, path_places(record))
    assert (made.share, made.recorded_distance_m) == pytest.approx((1, 18))
    assert deviation(record, path_places(record)).along_max_m == pytest.approx(0, abs=1e-9)


def test_one_step_is_no_progress() -> None:
    record = record_of(FIVE[:1], straight(FIVE[:1], 0, 0, 0, 3))
    assert progress(record, path_places(record)).reason == "progress needs two steps, and there is one"
    assert deviation(record, path_places(record)).across_max_m == pytest.approx(0, abs=1e-12)


def poses(motion: FloatArray, z: FloatArray | float = 0.0, pitch: float = 0.0) -> FloatArray:
    """Poses of the rear axle's ground point of motion along x."""
    out = np.tile(np.eye(4), (len(motion), 1, 1))
    out[:, 0, 3], out[:, 1, 3], out[:, 2, 3] = motion[:, 0], motion[:, 1], z
    out[:, 0, 0] = out[:, 2, 2] = np.cos(pitch)
    out[:, 0, 2], out[:, 2, 0] = -np.sin(pitch), np.sin(pitch)
    return out


def wall(points: FloatArray) -> BoolArray:
    """A wall across the road from x = 20 on, and a kerb before it."""
    return np.asarray((points[:, 0] >= 20) | ((points[:, 0] >= 5) & (points[:, 2] < 0.15)))


def test_a_wall_is_hit_by_the_front_and_a_kerb_is_not() -> None:
    motion = straight(FIVE, 0, 0, 0, 8)
    found = static_collision(record_of(FIVE, motion, ego_poses=poses(motion)), wall)
    assert found.collided and not found.at_start
    assert found.first_s == pytest.approx(np.ceil((20 - FRONT) / 8 * 10) / 10)
    # 24 planes of 11 x 7 points once the whole box is inside
    assert found.most_points == (int(np.ceil(LENGTH / 0.2)) + 1) * 11 * 7
    stopped = static_collision(record_of(FIVE[:21], motion[:21], ego_poses=poses(motion[:21])), wall)
    assert (stopped.collided, stopped.first_s, stopped.steps) == (False, None, 0)


def test_the_box_lies_on_the_ground_where_that_climbs() -> None:
    motion = straight(FIVE, 0, 0, 0, 8)
    slope = 0.2

    def hill(points: FloatArray) -> BoolArray:
        return np.asarray(points[:, 2] < points[:, 0] * np.tan(slope))

    climbing = record_of(FIVE, motion, ego_poses=poses(motion, motion[:, 0] * np.tan(slope), slope))
    assert static_collision(climbing, hill).collided is False
    level = record_of(FIVE, motion, ego_poses=poses(motion, motion[:, 0] * np.tan(slope)))
    assert static_collision(level, hill).collided is True


def test_noise_of_a_few_points_is_no_collision() -> None:
    motion = straight(FIVE[:1], 0, 0, 0, 0)
    record = record_of(FIVE[:1], motion, ego_poses=poses(motion))
    assert static_collision(record, Specks(4)).collided is False
    found = static_collision(record, Specks(5))
    assert (found.collided, found.at_start, found.most_points) == (True, True, 5)


class Specks:
    """An occupancy that has its first points in matter."""

    def __init__(self, count: int) -> None:
        self.count = count

    def __call__(self, points: FloatArray) -> BoolArray:
        return np.arange(len(points)) < self.count


def test_what_the_static_scene_needs() -> None:
    motion = straight(FIVE, 0, 0, 0, 8)
    assert static_collision(record_of(FIVE, motion), None).reason == "the scene's occupancy is not known"
    assert static_collision(record_of(FIVE, motion), wall).reason == "the record has no heights of the ego"

    def numbers(points: FloatArray) -> Any:
        return np.zeros(len(points))

    with pytest.raises(RecordError, match=r"occupied\(\) must answer 1848 points .* not float64 \(1848,\)"):
        static_collision(record_of(FIVE, motion, ego_poses=poses(motion)), numbers)


@pytest.mark.parametrize(("aside", "outside"), [(2.49, 0.0), (2.5, 0.0), (2.6, 0.1), (-3.0, 0.5)])
def test_a_corridor_of_seven_metres_holds_a_car_two_and_a_half_aside(aside: float, outside: float) -> None:
    long = straight(FIVE, -9, 0, 0, 14)
    found = off_road(record_of(FIVE, straight(FIVE, 0, aside, 0, 10), log=long))
    assert found.off_road is (outside > 0)
    assert found.farthest_m == pytest.approx(outside, abs=1e-9)
    assert found.steps_share == (1.0 if outside else 0.0)
    assert (found.method, found.corridor_width_m) == ("recorded_corridor", 7.0)


@pytest.mark.parametrize("speed", [10.0, 0.0])
def test_a_long_vehicle_that_repeats_the_log_stays_on_the_road_to_its_end(speed: float) -> None:
    """The recorded path ends at the rear axle: the front of the vehicle was farther."""
    motion = straight(FIVE, 3, 4, 0.7, speed)
    record = record_of(FIVE, motion)
    longer = tuple(replace(box, length_m=box.length_m + 4) for box in record.ego_footprints)
    assert not off_road(replace(record, ego_footprints=longer)).off_road
    on = straight(FIVE, 3, 4, 0.7, 12)
    assert off_road(
        replace(record_of(FIVE, on, log=motion), ego_footprints=record_of(FIVE, on).ego_footprints)
    ).off_road


def test_where_another_vehicle_drove_is_road_too() -> None:
    long = straight(FIVE, -9, 0, 0, 14)
    ego = straight(FIVE, 0, 0, 0, 10)
    ego[:, 1] = np.clip(FIVE - 1, 0, 3)
    alone = off_road(record_of(FIVE, ego, log=long))
    assert alone.first_s == pytest.approx(3.6) and alone.steps_share == pytest.approx(15 / 51)
    other = np.array([[-20.0, 3.5], [80.0, 3.5]])
    assert not off_road(record_of(FIVE, ego, log=long, recorded_paths=(other,))).off_road
    assert not off_road(record_of(FIVE, ego, log=long), corridor_width_m=8.0).off_road


def test_road_labels_decide_where_there_are_any() -> None:
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 10))
    found = off_road(record, lambda points: points[:, 0] < 30)
    assert (found.off_road, found.method, found.corridor_width_m) == (True, "road_labels", None)
    assert found.first_s == pytest.approx(np.ceil((30 - FRONT) * 10) / 100, abs=0.1)
    assert not off_road(record, lambda points: np.abs(points[:, 1]) <= 1).off_road
    with pytest.raises(RecordError, match=r"on_road\(\) must answer 204 points with as many truth values"):
        off_road(record, lambda points: points[:3, 0] < 30)
    with pytest.raises(RecordError, match="width of the corridor is nan m"):
        off_road(record, corridor_width_m=float("nan"))


def test_distances_to_many_paths_are_those_of_each() -> None:
    rng = np.random.default_rng([28, 3])
    points = rng.uniform(-50, 50, (300, 2))
    paths = tuple(rng.uniform(-60, 60, (1, 2)) + np.cumsum(rng.normal(0, 2, (40, 2)), 0) for _ in range(7))
    fine = np.concatenate(
        [p[:-1, None] + np.linspace(0, 1, 100)[:, None] * np.diff(p, axis=0)[:, None] for p in paths]
    ).reshape(-1, 2)
    brute = np.array([np.linalg.norm(fine - point, axis=-1).min() for point in points])
    found = corridor_distance(points, paths, 3.0)
    far = brute > 3.0
    assert found[far] == pytest.approx(brute[far], abs=0.05)
    assert (found[~far] <= 3.0).all() and 30 < far.sum() < 290


def test_what_follows_an_invalid_step_is_left_out() -> None:
    """A collision after the first invalid step counts in the plain scores, and not in those of the valid part."""
    times = np.arange(12) * 0.5
    car = straight(times, 40, 0, 0, 0), (4.0, 2.0)
    shares = (None, *[0.95] * 6, 0.5, *[0.9] * 4)
    record = record_of(times, straight(times, 0, 0, 0, 8), {"car": car}, confidence=shares)
    found = validity(record)
    assert (found.invalid_steps, found.valid_steps, found.valid_until_s) == (1, 7, 3.0)
    assert (found.mean_confidence, found.min_confidence) == pytest.approx(((6 * 0.95 + 0.5 + 4 * 0.9) / 11, 0.5))
    scores = summarise(record)
    part = scores["valid_part"]
    assert scores["collision"]["count"] == 1 and part["collision"]["count"] == 0 and part["steps"] == 7
    assert part["validity"]["invalid_steps"] == 0 and "valid_part" not in part
    table = score_table(scores)
    assert "confidence" in table and "valid part" in table
    sound = record_of(times, straight(times, 0, 0, 0, 8), confidence=(0.8,) * 12)
    assert validity(sound).invalid_steps == 0 and "valid_part" not in summarise(sound)
    assert validity(record_of(times, straight(times, 0, 0, 0, 8))).reason is not None


def test_when_the_unsupported_share_is_first_too_great() -> None:
    shares = (None, 0.0, 0.2, None, 0.21, 0.1)
    record = record_of(FIVE[:6], straight(FIVE[:6], 0, 0, 0, 1), unsupported_share=shares)
    found = unsupported(record)
    assert found.above_20_percent_at_s == pytest.approx(0.4)
    assert (found.mean_share, found.max_share) == pytest.approx((0.51 / 4, 0.21))
    never = record_of(FIVE[:2], straight(FIVE[:2], 0, 0, 0, 1), unsupported_share=(0.2, 0.1))
    assert unsupported(never).above_20_percent_at_s is None
    for blind in (None, (None, None)):
        record = record_of(FIVE[:2], straight(FIVE[:2], 0, 0, 0, 1), unsupported_share=blind)
        assert unsupported(record).reason == "the driver was shown no pixels whose support was measured"


def test_the_box_of_the_helper_is_the_one_its_cases_are_worked_out_for() -> None:
    (front_left, rear_left), _ = record_of(FIVE[:1], straight(FIVE[:1], 0, 0, 0, 0)).ego_footprints[0].corners[:2], 0
    assert front_left == pytest.approx((FRONT, 1.0)) and rear_left == pytest.approx((REAR, 1.0))
