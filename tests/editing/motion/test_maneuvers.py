"""Maneuvers on a winding road: what they promise, that nothing of them is implausible, and what they refuse."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imported_scene import changed, imported, sampled_object
from winding_drive import ROAD, TIMES, on_road, winding_drive

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.scenario import apply_scenario, scenario_from_json
from unisim_blender.core.scenario.edit import EDITS
from unisim_blender.core.scenario.motion.maneuvers import FRONT_M, DrivenPath, Maneuver, Quintic, smoothed
from unisim_blender.core.simulation.vehicle.parameters import Vehicle
from unisim_blender.core.world.drive import Drive
from unisim_blender.editing.motion.kinematics import is_limited, motion_of
from unisim_blender.editing.motion.plausibility import warnings_of
from unisim_blender.editing.sampled.clock import Clock, recorded_poses, recorded_there
from unisim_blender.editing.sampled.scene import Sampled

DRIVE = winding_drive()
CLOCK = Clock.of(DRIVE)


def edited(*edits: dict[str, Any], drive: Drive = DRIVE) -> Drive:
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "l", "edits": list(edits)}
    return apply_scenario(scenario_from_json(document), drive, lambda path: {})


def warnings(drive: Drive, uid: str) -> list[str]:
    """What Check Edits says of an actor, in a drive whose other actors are as recorded."""
    now, sampled = drive.actors[uid], imported(DRIVE)
    poses, there = recorded_poses(now, CLOCK), recorded_there(now, drive, CLOCK)
    if uid in DRIVE.actors:
        sampled = changed(sampled, uid, poses=poses, there=there)
    else:
        new = sampled_object(
            uid, "ACTOR", poses, there, uid=now.appearance.actor, original_name="",
            size_m=tuple(now.size_m.tolist()),
        )  # fmt: skip
        sampled = replace(sampled, objects=(*sampled.objects, new))
    return [f"{finding.name} {finding.text}" for finding in warnings_of(sampled, DRIVE)]


def only(kind: str, uid: str, at: float, **numbers: Any) -> list[str]:
    """The warnings but for overlaps of a maneuver of a recorded actor."""
    now = edited({"type": kind, "actor": uid, "at_s": at, **numbers})
    return [text for text in warnings(now, uid) if "overlaps" not in text]


def ego_coordinates(drive: Drive, uid: str, time_s: float) -> tuple[float, float]:
    """How far an actor's centre is ahead of the ego's front along the ego's path, and to the left of that path."""
    course = DrivenPath.of(drive.world_from_ego)
    assert course is not None
    gone, left, _ = course.nearest(drive.actors[uid].world_from_actor.at(time_s)[:3, 3])
    return gone - float(course.gone(time_s)) - FRONT_M, left


def speeds(drive: Drive, uid: str) -> FloatArray:
    return motion_of(recorded_poses(drive.actors[uid], CLOCK)[:, :3, 3], TIMES).speed_m_s


@pytest.mark.parametrize("at", [0.0, 1.5, 3.0, 4.7])
def test_nothing_of_a_maneuver_is_implausible(at: float) -> None:
    for uid in ("near", "right", "ahead"):
        for left_m in (3.5, -3.5, 1.0):
            assert only("lane_change", uid, at, left_m=left_m) == [], (uid, left_m)
        for deceleration in (1.5, 3.0, 5.5):
            for speed in (0.0, 4.0):
                assert only("brake", uid, at, deceleration_m_s2=deceleration, speed_m_s=speed) == [], (uid, speed)
    for side in ("left", "right"):
        for gap in ({"gap_s": 1.0}, {"gap_s": 2.0}, {"gap_m": 6.0}, {"gap_m": 10.0, "speed_m_s": 7.0}):
            new = {"type": "duplicate", "actor": "near", "id": "new"}
            now = edited(new, {"type": "cut_in", "actor": "new", "at_s": at, "side": side, **gap})
            assert [text for text in warnings(now, "new") if "overlaps" not in text] == [], (side, gap)
    for speed in (1.0, 1.4, 3.0):
        for side in ("left", "right"):
            told = only("cross", "walker", at + 3, side=side, speed_m_s=speed, gap_m=8.0)
            # it stands and waits, which nobody recorded of it
            assert [text for text in told if "its pose is extrapolated" not in text] == []
    assert only("cut_in", "near", at, gap_s=1.0) == []


def test_a_lane_change_ends_beside_the_path_and_keeps_what_was_before() -> None:
    before = DRIVE.actors["near"].world_from_actor
    now = edited({"type": "lane_change", "actor": "near", "at_s": 2.0, "left_m": 3.0, "duration_s": 4.0}).actors["near"]
    keys = before.times_s < 2.0
    assert (now.world_from_actor.positions[: keys.sum()] == before.positions[keys]).all()
    late = TIMES >= 6.0
    apart = np.linalg.inv(before.at(TIMES[late])) @ now.world_from_actor.at(TIMES[late])
    assert np.abs(apart[:, 1, 3] - 3.0).max() < 0.12 and np.abs(apart[:, 0, 3]).max() < 0.15
    assert now.is_moving and (now.start_s, now.end_s) == (-1.0, 11.0)


def test_a_braking_actor_decelerates_as_asked_and_stands() -> None:
    now = edited({"type": "brake", "actor": "right", "at_s": 3.0, "deceleration_m_s2": 4.0})
    motion = motion_of(recorded_poses(now.actors["right"], CLOCK)[:, :3, 3], TIMES)
    assert motion.acceleration_m_s2.min() == pytest.approx(-4.0, abs=0.35)
    stands = recorded_poses(now.actors["right"], CLOCK)[TIMES >= 6.5]
    assert np.abs(stands - stands[0]).max() < 1e-6
    slower = speeds(
        edited({"type": "brake", "actor": "right", "at_s": 3, "deceleration_m_s2": 2, "speed_m_s": 5}), "right"
    )
    assert np.abs(slower[TIMES > 7.0] - 5.0).max() < 0.3
    goes_on = {"type": "brake", "actor": "right", "at_s": 1.0, "deceleration_m_s2": 5.0, "stands_s": 1.0}
    again = edited(goes_on | {"acceleration_m_s2": 3.0}).actors["right"]
    motion = motion_of(recorded_poses(again, CLOCK)[:, :3, 3], TIMES)
    stood = TIMES[motion.speed_m_s < 0.05]
    assert 0.6 < stood[-1] - stood[0] < 1.2 and motion.acceleration_m_s2.max() == pytest.approx(3.0, abs=0.3)


@pytest.mark.parametrize("shift_m", [0.0, -1.5])
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_crossing_actor_is_in_front_of_the_ego_at_its_time(side: str, shift_m: float) -> None:
    """Of the ego as it is recorded, and as it is edited."""
    ego = [{"type": "ego", "shift_left_m": shift_m}] if shift_m else []
    for at, gap in ((3.0, 8.0), (5.05, 0.0), (7.3, 15.0)):
        cross = {"type": "cross", "actor": "walker", "at_s": at, "side": side, "speed_m_s": 1.4, "gap_m": gap}
        now = edited(*ego, cross)
        ahead, left = ego_coordinates(now, "walker", at)
        assert (ahead, left) == pytest.approx((gap, 0.0), abs=0.05)
        _, before = ego_coordinates(now, "walker", at - 2.0)
        assert before == pytest.approx(2.8 if side == "left" else -2.8, abs=0.3)
        _, first = ego_coordinates(now, "walker", 0.0)
        assert abs(first) == pytest.approx(6.0, abs=0.6) or at < 4.5
    by_time = edited({**{k: v for k, v in cross.items() if k != "gap_m"}, "gap_s": 1.0})
    course = DrivenPath.of(DRIVE.world_from_ego)
    assert course is not None
    assert ego_coordinates(by_time, "walker", at)[0] == pytest.approx(float(course.speed(at)), abs=0.1)


@pytest.mark.parametrize("who", [{}, {"side": "left"}, {"side": "right", "lane_m": 3.2}])
def test_a_cut_in_ends_at_its_gap_in_the_lane_of_the_ego(who: dict[str, Any]) -> None:
    cut = {"type": "cut_in", "actor": "near", "at_s": 2.0, "duration_s": 4.0, **who}
    half = DRIVE.actors["near"].size_m[0] / 2
    for gap in (10.0, 12.0):
        now = edited({**cut, "gap_m": gap})
        for at in (6.0, 8.0, 10.0):
            ahead, left = ego_coordinates(now, "near", at)
            assert (ahead - half, left) == pytest.approx((gap, 0.0), abs=0.1)
    if who:
        _, left = ego_coordinates(now, "near", 1.9)
        assert left == pytest.approx(3.5 if who["side"] == "left" else -3.2, abs=0.05)
        steady = edited({**cut, "gap_s": 1.5, "speed_m_s": 8.0})
        assert np.abs(speeds(steady, "near")[TIMES > 6.5] - 8.0).max() < 0.1
    else:
        same = TIMES < 2.0
        poses = recorded_poses(now.actors["near"], CLOCK)
        assert (poses[same] == recorded_poses(DRIVE.actors["near"], CLOCK)[same]).all()


def test_a_follower_keeps_its_gaps_on_the_path_of_its_leader() -> None:
    brake = {"type": "brake", "actor": "ahead", "at_s": 2.0, "deceleration_m_s2": 2.0}
    now = edited(
        brake,
        {"type": "duplicate", "actor": "near", "id": "second"},
        {"type": "follow", "actor": "second", "leader": "ahead", "gap_s": 1.0, "gap_m": 2.0},
    )
    first, second = (recorded_poses(now.actors[uid], CLOCK) for uid in ("ahead", "second"))
    stands = np.linalg.norm((first - second)[-1, :2, 3])
    assert stands == pytest.approx(2.0 + (11.0 + 4.4) / 2, abs=0.1)
    driving = np.linalg.norm((first - second)[15, :2, 3])
    assert driving == pytest.approx(2.0 + (11.0 + 4.4) / 2 + 8.0, abs=0.3)
    underside = second[:, 2, 3] - 0.75, np.interp(second[:, 0, 3], ROAD[:, 0], ROAD[:, 2])
    assert np.abs(underside[0] - underside[1]).max() < 0.1
    assert [text for text in warnings(now, "second") if "overlaps" not in text] == []


REFUSALS = (
    ({"type": "lane_change", "actor": "near", "at_s": 9.0, "left_m": 3.5}, "are left: begin earlier"),
    ({"type": "lane_change", "actor": "near", "at_s": 12.0, "left_m": 3.5}, 'is there from -1.00 to 11.00 s, not at 12 s'),
    ({"type": "brake", "actor": "near", "at_s": 3, "deceleration_m_s2": 2, "speed_m_s": 20}, "no faster than 20 m/s"),
    ({"type": "cut_in", "actor": "ahead", "at_s": 1.0, "gap_m": 5}, "it cannot be 5 m ahead within"),
    ({"type": "cut_in", "actor": "walker", "at_s": 1.0, "gap_m": 5}, "give a side, which puts the actor into one"),
    ({"type": "cut_in", "actor": "near", "at_s": 9.5, "gap_m": 5, "side": "left"}, "s are left: begin earlier"),
    ({"type": "cut_in", "actor": "near", "at_s": 9.5}, "needs gap_s or gap_m, one of them"),
    ({"type": "cross", "actor": "walker", "at_s": 99, "side": "left", "speed_m_s": 1, "gap_m": 1}, "lies outside the log"),
    ({"type": "follow", "actor": "near", "leader": "near", "gap_s": 1, "gap_m": 1}, '"near" cannot follow itself'),
)  # fmt: skip


@pytest.mark.parametrize(
    ("edit", "sentence"), REFUSALS, ids=lambda value: value["type"] if isinstance(value, dict) else ""
)
def test_what_cannot_be_is_refused_in_a_sentence(edit: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        edited(edit)
    assert sentence in str(caught.value) and str(caught.value).startswith("scenario.json: edits[0]")
    assert "\n" not in str(caught.value)


def test_what_stands_has_no_maneuver_but_crossing() -> None:
    parked = replace(DRIVE.actors["near"], world_from_actor=on_road(np.full(101, 60.0), 3.5, 0.7, 0.02))
    drive = replace(DRIVE, actors={**DRIVE.actors, "near": parked})
    for edit in ({"type": "brake", "deceleration_m_s2": 2}, {"type": "lane_change", "left_m": 3}):
        with pytest.raises(ScenarioError, match='"near" stands at 2 s: this needs an actor that moves'):
            edited({**edit, "actor": "near", "at_s": 2}, drive=drive)
    with pytest.raises(ScenarioError, match='"near" stands: there is nothing to follow'):
        edited({"type": "follow", "actor": "right", "leader": "near", "gap_s": 1, "gap_m": 1}, drive=drive)


def test_the_bumper_is_that_of_the_simulated_vehicle() -> None:
    assert Vehicle().length_m - Vehicle().rear_overhang_m == pytest.approx(FRONT_M)
    assert {kind.type for kind in EDITS.values() if issubclass(kind, Maneuver)} == {
        "lane_change", "brake", "cut_in", "cross", "follow",
    }  # fmt: skip


REAL_LOG = Path(os.environ.get("UNISIM_PANDASET", Path(__file__).parents[4] / "shared/data/pandaset/002"))


@pytest.mark.skipif(not REAL_LOG.is_dir(), reason="no PandaSet log is at hand")
def test_nothing_is_implausible_on_a_recorded_street() -> None:
    """Of all vehicles that drive, at several times, whose annotations are noisy; what cannot be is refused."""
    drive = open_log(REAL_LOG).drive
    clock, done, refused = Clock.of(drive), 0, 0
    for uid, known in drive.actors.items():
        there, poses = recorded_there(known, drive, clock), recorded_poses(known, clock)
        speed = motion_of(poses[:, :3, 3], clock.times_s, there).speed_m_s
        for at in (4, 24, 44) if known.is_moving and is_limited(known.label) else ():
            if not there[at] or speed[at] < 2.0:
                continue
            values = {"actor": uid, "at_s": float(clock.times_s[at])}
            for edit in (
                {"type": "lane_change", "left_m": 3.5},
                {"type": "lane_change", "left_m": -3.5},
                {"type": "brake", "deceleration_m_s2": 2.0},
                {"type": "cut_in", "gap_s": 1.5},
            ):
                try:
                    now = edited(values | edit, drive=drive)
                except ScenarioError:
                    refused += 1
                    continue
                new = now.actors[uid]
                obj = sampled_object(
                    uid, "ACTOR", recorded_poses(new, clock), recorded_there(new, now, clock),
                    size_m=tuple(new.size_m.tolist()),
                )  # fmt: skip
                findings = warnings_of(Sampled("real", clock, (obj,)), drive)
                assert [str(finding.text) for finding in findings] == [], (values, edit)
                done += 1
    assert done > 60 and refused < 2 * done, (done, refused)


def test_polynomials_and_smoothing() -> None:
    curve = Quintic((1.0, 2.0, 0.5), (7.0, -1.0, 0.25), 3.0)
    for order, (start, end) in enumerate(((1.0, 7.0), (2.0, -1.0), (0.5, 0.25))):
        assert curve.at(np.array([0.0, 3.0]), order) == pytest.approx([start, end])
    line = np.linspace(2.0, 9.0, 30)
    assert np.abs(smoothed(line, 3.5) - line).max() < 1e-12
    assert smoothed(np.array([1.0]), 3.5).tolist() == [1.0]
