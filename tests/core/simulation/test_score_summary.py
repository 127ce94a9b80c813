"""All scores as one document and as a table, and records that cannot be scored."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from driven_record import record_of, straight, times

from unisim_blender.core.geometry import BoolArray, FloatArray
from unisim_blender.core.simulation.footprints import distances, footprint_corners, overlap
from unisim_blender.core.simulation.scores.record import PlanRecord, Record, RecordError
from unisim_blender.core.simulation.scores.summary import score_table, summarise

FIVE = times(5.0)
CAR = (4.0, 2.0)


def behind_the_car(points: FloatArray) -> BoolArray:
    return np.asarray(points[:, 0] > 44)


def rich() -> Record:
    """A record with all that there can be: the ego runs into a car that stands."""
    ego = straight(FIVE, 0, 0, 0, 10)
    poses = np.tile(np.eye(4), (51, 1, 1))
    poses[:, 0, 3] = ego[:, 0]
    plans = []
    for made in range(5):
        ahead = np.stack([10.0 * made + 10.0 * np.arange(1, 8), np.zeros(7), np.zeros(7)], -1)
        plans.append(PlanRecord(made * 1_000_000, (made + np.arange(1, 8)) * 1_000_000, ahead))
    actors = {"a": (straight(FIVE, 40, 0, 0, 0), CAR), "b": (straight(FIVE, 0, 20, 0, 5), CAR)}
    shares = tuple(float(value) for value in np.linspace(0, 0.4, 51))
    return record_of(
        FIVE, ego, actors, plans=tuple(plans), unsupported_share=shares, ego_poses=poses,
        recorded_paths=(np.array([[0.0, 20], [25, 20]]),),
    )  # fmt: skip


def poor() -> Record:
    """A record of one step and nothing else."""
    return record_of(FIVE[:1], straight(FIVE[:1], 0, 0, 0, 0))


def keys(value: Any) -> Any:
    """The names of a nested object, lists and values left out."""
    return {name: keys(one) for name, one in value.items()} if isinstance(value, dict) else None


def test_the_summary_is_json_and_always_has_the_same_members() -> None:
    full = summarise(rich(), occupied=behind_the_car)
    empty = summarise(poor())
    for scores in (full, empty):
        assert json.loads(json.dumps(scores, allow_nan=False)) == scores
    assert keys(full) == keys(empty)


def test_what_cannot_be_computed_is_null_beside_a_reason() -> None:
    scores = summarise(poor())
    for name, member in (
        ("collision", "count"), ("time_to_collision", "minimum_s"), ("ncap", "stars"), ("comfort", "comfortable"),
        ("progress", "share"), ("plan_consistency", "mean_m"), ("unsupported", "mean_share"), ("pdms", "score"),
        ("hd_score", "score"), ("alpasim_score", "score"), ("static_collision", "collided"),
    ):  # fmt: skip
        assert scores[name][member] is None, name
        assert scores[name]["reason"], name
    assert scores["off_road"]["off_road"] is False


def test_the_summary_holds_what_the_scores_say() -> None:
    scores = summarise(rich(), occupied=behind_the_car)
    assert (scores["steps"], scores["duration_s"], scores["actors"]) == (51, 5.0, 2)
    assert scores["collision"]["count"] == scores["collision"]["at_fault_count"] == 1
    assert scores["collision"]["contacts"][0]["actor"] == "a"
    assert scores["collision"]["first_s"] == pytest.approx(3.475)
    assert scores["ncap"]["stars"] == 0
    assert scores["pdms"]["score"] == scores["alpasim_score"]["score"] == 0
    assert scores["time_to_collision"]["minimum_s"] == 0
    assert scores["time_to_collision"]["below_bound_at_s"] == pytest.approx(2.5)
    assert scores["static_collision"]["first_s"] == pytest.approx(4.1)
    assert scores["unsupported"]["above_20_percent_at_s"] == pytest.approx(2.6)
    assert scores["plan_consistency"]["end_point_mean_m"] == pytest.approx(0, abs=1e-9)
    # each plan drives through the car
    assert (scores["hd_score"]["plans"], scores["hd_score"]["score"], scores["hd_score"]["comfort_mean"]) == (5, 0, 1)


def test_the_table_has_a_line_for_each_score() -> None:
    lines = score_table(summarise(rich(), occupied=behind_the_car)).splitlines()
    text = "\n".join(lines)
    assert "a (Car) front, 10.00 m/s, at fault" in text
    assert "at 3.475 s" in text
    assert "below 1 s from 2.50 s on" in text
    assert "yaw acceleration" in text and "rad/s²" in text
    assert "without drivable_area_compliance" in text
    columns = {line.index(line.strip().split("  ")[-1].strip()) for line in lines}
    assert len(columns) == 1  # values are aligned
    poor_lines = score_table(summarise(poor())).splitlines()
    assert any(line.startswith("PDMS") and "- (no no_at_fault_collision" in line for line in poor_lines)


def test_the_table_of_a_document_read_back_is_the_same() -> None:
    scores = summarise(rich())
    assert score_table(json.loads(json.dumps(scores))) == score_table(scores)


def test_the_same_record_in_another_place_has_the_same_scores() -> None:
    # turned by a right angle and moved: nothing may depend on the axes of the world
    def placed(motion: FloatArray) -> FloatArray:
        return np.stack([100 - motion[:, 1], motion[:, 0] - 50, motion[:, 2] + np.pi / 2, motion[:, 3]], -1)

    ego, lead = straight(FIVE, 0, 0, 0.1, 9), straight(FIVE, 20, 4, 0, 6)
    side = straight(FIVE, 30, -30, np.pi / 2, 6)
    here = summarise(record_of(FIVE, ego, {"a": (lead, CAR), "b": (side, CAR)}))
    there = summarise(record_of(FIVE, placed(ego), {"a": (placed(lead), CAR), "b": (placed(side), CAR)}))
    assert here["collision"]["count"] is not None

    def close(one: Any, other: Any) -> bool:
        if isinstance(one, dict):
            return all(close(one[name], other[name]) for name in one)
        if isinstance(one, list):
            return len(one) == len(other) and all(close(a, b) for a, b in zip(one, other, strict=True))
        return one == pytest.approx(other, abs=1e-6) if isinstance(one, float) else one == other

    assert close(here, there)


@pytest.mark.parametrize("speed", [0.0, 60.0])
def test_scores_are_finite_at_rest_and_at_sixty_metres_a_second(speed: float) -> None:
    actors = {"a": (straight(FIVE, 30, 0, 0, speed), CAR), "b": (straight(FIVE, -9, 0, 0, 0), CAR)}
    with np.errstate(all="raise", under="ignore"):
        scores = summarise(record_of(FIVE, straight(FIVE, 0, 0, 0, speed), actors))
    json.dumps(scores, allow_nan=False)
    assert scores["collision"]["count"] == 0
    assert scores["pdms"]["score"] == 1


def broken(**changes: Any) -> None:
    replace(rich(), **changes)


def test_records_that_are_not_sound_are_refused_in_one_sentence() -> None:
    record = rich()
    nan = float("nan")
    ego = (*record.ego[:7], replace(record.ego[7], speed_m_s=nan), *record.ego[8:])
    with pytest.raises(
        RecordError, match=r"^the ego's state at step 7 \(0.7 s\) is not finite: \[7.0+1?, 0.0, 0.0, nan"
    ):
        broken(ego=ego)
    boxes = (replace(record.ego_footprints[0], width_m=0.0), *record.ego_footprints[1:])
    with pytest.raises(RecordError, match=r"^the ego's footprint at step 0 \(0 s\) is no box"):
        broken(ego_footprints=boxes)
    actors = (*record.actors[:3], (replace(record.actors[3][0], x_m=nan),), *record.actors[4:])
    with pytest.raises(RecordError, match=r"^the footprint of actor a at step 3 \(0.3 s\) is no box"):
        broken(actors=actors)
    twice = (*record.actors[:3], (record.actors[3][0],) * 2, *record.actors[4:])
    with pytest.raises(RecordError, match="^actor a stands twice in the record at step 3"):
        broken(actors=twice)
    with pytest.raises(RecordError, match='^an actor of the record has the uid "ego"'):
        broken(actors=((record.ego_footprints[0],), *record.actors[1:]))
    with pytest.raises(RecordError, match="^the record has 51 times and 50 of ego$"):
        broken(ego=record.ego[1:])
    with pytest.raises(RecordError, match="^the record needs times in whole microseconds"):
        broken(times_us=FIVE)
    with pytest.raises(RecordError, match="time 1, 0 us, that is not later than 0 us"):
        broken(times_us=np.zeros(51, np.int64))
    with pytest.raises(RecordError, match=r"^the unsupported share at step 1 \(0.1 s\) is nan"):
        broken(unsupported_share=(0.1, nan, *record.unsupported_share[2:]))  # type: ignore[index]
    with pytest.raises(RecordError, match="^the ego's pose at step 2"):
        poses = np.array(record.ego_poses)
        poses[2, 0, 3] = nan
        broken(ego_poses=poses)
    with pytest.raises(RecordError, match="^recorded path 0 is no list"):
        broken(recorded_paths=(np.full((3, 2), nan),))
    with pytest.raises(RecordError, match="^plans are not in the order"):
        broken(plans=(record.plans or ())[::-1])
    with pytest.raises(RecordError, match="^the plan of 2 s has a pose 1 that is not finite"):
        PlanRecord(2_000_000, np.array([1, 2]), np.array([[0.0, 0, 0], [nan, 0, 0]]))
    with pytest.raises(RecordError, match="^the plan of 0 s needs times in whole microseconds, one at least"):
        PlanRecord(0, np.array([], np.int64), np.zeros((0, 3)))


def test_it_says_what_took_something_off_a_score() -> None:
    """The ego runs into a car that stands at 40 m: hand-worked, its front is 3.9 m ahead of the axle in `driven_record`'s box."""
    scores = summarise(rich())
    contact, times_ = scores["collision"]["contacts"][0], scores["time_to_collision"]
    terms = {one["term"]: one for one in scores["pdms"]["broken"]}
    assert terms["no_at_fault_collision"] == {
        "term": "no_at_fault_collision", "value": 0.0, "at_s": contact["time_s"], "by": "a",
    }  # fmt: skip
    close = terms["time_to_collision_within_bound"]
    assert (close["value"], close["by"], close["at_s"]) == (0.0, "a", times_["below_bound_at_s"])
    assert contact["time_s"] - 1 < close["at_s"] < contact["time_s"] and "comfort" not in terms
    plans = {one["term"]: one for one in scores["hd_score"]["broken"]}
    assert plans["no_collision"]["at_s"] == 0.0 and plans["no_collision"]["by"] == "the plan made then"
    lines = score_table(scores).splitlines()
    assert any(line.startswith("  no at fault collision") and line.endswith("(a)") for line in lines)
    assert any(line.startswith("least distance") and "0.00 m at" in line and line.endswith("(a)") for line in lines)


def test_a_jolt_is_named_with_its_time() -> None:
    ego = straight(FIVE, 0, 0, 0, 10)
    speeds = np.where(FIVE > 2.45, 9.0, 10.0)
    record = record_of(FIVE, ego, {"b": (straight(FIVE, 0, 20, 0, 5), CAR)})
    record = replace(
        record, ego=tuple(replace(one, speed_m_s=float(v)) for one, v in zip(record.ego, speeds, strict=True))
    )
    (comfort,) = [one for one in summarise(record)["pdms"]["broken"] if one["term"] == "comfort"]
    assert comfort["value"] == 0 and comfort["at_s"] == pytest.approx(2.4) and "jerk" in comfort["by"]


def test_the_least_distance_of_turned_boxes() -> None:
    """A unit square turned by 45 degrees, its corner toward a side; squares corner to corner; and against sampled edges."""
    a = np.array([0.0, 0.0, 2.0, 2.0, 0.0])
    assert distances(a, np.array([5.0, 0.0, 2.0, 2.0, np.pi / 4])) == pytest.approx(4 - np.sqrt(2))
    assert distances(a, np.array([4.0, 5.0, 2.0, 2.0, 0.0])) == pytest.approx(np.hypot(2, 3))
    assert distances(a, np.array([0.5, 0.0, 8.0, 0.2, 1.0])) == 0 and distances(a, np.array([2.0, 0, 2.0, 2.0, 0])) == 0
    rng, u = np.random.default_rng(4), np.linspace(0, 1, 401)[:, None]
    for _ in range(20):
        one, other = (np.array([*rng.uniform(-6, 6, 2), *rng.uniform(0.5, 5, 2), rng.uniform(-4, 4)]) for _ in range(2))
        edges = [
            np.concatenate([p + u * (q - p) for p, q in zip(c, np.roll(c, -1, 0), strict=True)])
            for c in (footprint_corners(one), footprint_corners(other))
        ]
        sampled = np.sqrt(((edges[0][:, None] - edges[1][None]) ** 2).sum(-1)).min()
        if not overlap(one, other):
            assert distances(one, other) == pytest.approx(sampled, abs=0.02) == distances(other, one)


def test_the_least_distance_of_a_drive() -> None:
    """Past a car that drives the other way 3.5 m to the left: 1.6 m between boxes that are 1.8 and 2 m wide, give or take."""
    actors = {"far": (straight(FIVE, 0, 20, 0, 5), CAR), "near": (straight(FIVE, 40, 3.5, np.pi, 8), CAR)}
    record = record_of(FIVE, straight(FIVE, 0, 0, 0, 10), actors)
    found = summarise(record)["minimum_distance"]
    assert found["actor"] == "near" and found["minimum_m"] == pytest.approx(3.5 - (record.ego_boxes[0, 3] + 2.0) / 2)
    assert 1.5 < found["minimum_at_s"] < 3
    assert summarise(poor())["minimum_distance"]["reason"] == "no other actor was present"
