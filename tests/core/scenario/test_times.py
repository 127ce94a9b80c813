"""A scenario's times: what they name, what is refused, and what is there before and after the recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_drive import IDENTITY, tiny_drive

from unisim_blender.core.errors import ScenarioError, UnisimError
from unisim_blender.core.geometry import Trajectory
from unisim_blender.core.scenario import apply_scenario, scenario_from_json, scenario_to_json
from unisim_blender.core.scenario.time_range import TimeRange
from unisim_blender.core.scenario.times import carried_outside, parse_times, scenario_times_us, with_times
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.world.drive import Actor, Appearance, Drive
from unisim_blender.core.world.replay import DriveStates

DRIVE = tiny_drive()


def scenario(**members: Any) -> Scenario:
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "log", "edits": []} | members
    read = scenario_from_json(document, Path("s.json"))
    assert scenario_to_json(read) == document, "a document that is read and written again is the same document"
    return read


@pytest.mark.parametrize(
    ("times", "wanted"),
    [
        ([0, 0.05, 0.1], [0, 50_000, 100_000]),
        ({"start_s": 0.1, "stop_s": 0.3, "rate_hz": 20}, [100_000, 150_000, 200_000, 250_000]),
        ({"stop_s": 0.1, "rate_hz": 30}, [0, 33_333, 66_667]),
        ({"start_s": 0.4, "rate_hz": 10}, [400_000, 500_000]),
        ({"start_s": 0.0, "stop_s": 0.01, "rate_hz": 0.5}, [0]),
    ],
)
def test_which_times_they_are(times: Any, wanted: list[int]) -> None:
    assert scenario_times_us(scenario(times=times), DRIVE) == (tuple(wanted), {})


def test_sensors_have_times_of_their_own() -> None:
    sensors = {
        "cameras": [{"id": "front", "times": {"start_s": 0, "stop_s": 0.1, "rate_hz": 30}}],
        "lidars": [{"id": "top"}],
    }
    own = {"camera/front": (0, 33_333, 66_667)}
    assert scenario_times_us(scenario(sensors=sensors), DRIVE) == (None, own)
    assert scenario_times_us(scenario(sensors=sensors, times=[0.1]), DRIVE) == ((100_000,), own)
    assert scenario_times_us(with_times(scenario(sensors=sensors, frames=[1]), parse_times("0:.2:10")), DRIVE) == (
        (0, 100_000),
        {},
    )
    assert with_times(scenario(sensors=sensors, frames=[1]), None).frames == (1,)


@pytest.mark.parametrize(
    ("members", "sentence"),
    [
        ({"times": [0], "frames": [1]}, r"s\.json: has both frames and times"),
        ({"times": [0, 0.1, 0.1000001]}, r"s\.json: times\[2\]: 0\.1 s must lie after the time before, 0\.1 s"),
        ({"times": {"start_s": 1, "stop_s": 1, "rate_hz": 5}}, r"s\.json: times: stop_s 1 must lie beyond start_s 1"),
        ({"times": {"start_s": 0, "stop_s": 500, "rate_hz": 5000}}, r"times: is 2500000 times, more than the 100000"),
        ({"times": {"rate_hz": 0}}, r"times\.rate_hz: 0 is less than or equal to the minimum"),
        ({"times": {"start_s": 0}}, r"times: 'rate_hz' is a required property"),
        ({"times": [2e6]}, r"times\[0\]: 2e\+06 is not within 1e\+06 s"),
        ({"times": []}, r"times: \[\]"),
        ({"outside": "absent"}, r"outside: the ego vehicle cannot be absent"),
        ({"outside": {"ego": "absent"}}, r"outside\.ego: 'absent' is not one of"),
        (
            {"sensors": {"lidars": [{"id": "top", "times": [1, 0]}]}},
            r"sensors\.lidars\[0\]\.times\[1\]: 0 s must lie after",
        ),
    ],
)
def test_what_contradicts_itself_is_one_sentence(members: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ScenarioError, match=sentence):
        scenario(**members)


def test_times_outside_the_recording_need_to_be_told_what_is_there() -> None:
    for times in ([0.2, 0.6], {"start_s": -0.1, "stop_s": 0.2, "rate_hz": 10}):
        with pytest.raises(
            ScenarioError, match=r"times: (0\.6|-0\.1) s lies outside the recording \(0 … 0\.5 s\): say what"
        ):
            scenario_times_us(scenario(times=times), DRIVE)
        assert scenario_times_us(scenario(times=times, outside={"ego": "hold"}), DRIVE)[0]
    with pytest.raises(ScenarioError, match=r"say what the ego vehicle does there"):
        scenario_times_us(scenario(times=[0.6], outside={"actors": "hold"}), DRIVE)
    with pytest.raises(
        ScenarioError, match=r"times: start_s 0\.7 s lies after the recording, which ends at 0\.5 s: give a stop_s"
    ):
        scenario_times_us(scenario(times={"start_s": 0.7, "rate_hz": 10}, outside="hold"), DRIVE)


@pytest.mark.parametrize("text", ("", "1:2", "0:1:0", "0:1:-2", "a:b:c", "0:1e9:10", "0:1:1e9", "0:nan:1", "1"))
def test_what_the_command_line_cannot_read_is_one_sentence(text: str) -> None:
    with pytest.raises(UnisimError, match="--times"):
        parse_times(text)


def test_the_command_lines_times() -> None:
    assert parse_times("0:8:20") == TimeRange(20.0, 0.0, 8.0) and parse_times("::30") == TimeRange(30.0)
    assert parse_times("-1.5::2.5") == TimeRange(2.5, -1.5)


def test_a_drive_whose_times_lie_within_the_recording_is_the_same() -> None:
    assert carried_outside(DRIVE, scenario(outside="hold"), (0, 250_000, 500_000)) is DRIVE
    assert carried_outside(DRIVE, scenario(), ()) is DRIVE


def parked(drive: Drive) -> Drive:
    """With a car that stands throughout the recording."""
    trajectory = Trajectory(np.zeros(1), np.array([[9.0, 4.0, 0.7]]), IDENTITY[None])
    return replace(
        drive,
        actors={
            **drive.actors,
            "stands": Actor("stands", "Car", np.ones(3), trajectory, 0.0, 0.5, False, Appearance("car")),
        },
    )


@pytest.mark.parametrize("rule", ("absent", "hold", "continue"))
def test_parked_actors_stay_and_moving_ones_do_as_they_are_told(rule: str) -> None:
    told = scenario(outside={"actors": rule, "ego": "continue"})
    drive = carried_outside(parked(DRIVE), told, (-2_000_000, 3_000_000))
    states = DriveStates(drive, {})
    for time_s in (-2.0, 3.0):
        state = states.state(time_s, time_s)
        there = {actor.uid: actor.world_from_actor.at(time_s)[:3, 3] for actor in state.actors}
        assert there.keys() - {"cone"} == ({"stands"} if rule == "absent" else {"stands", "car"})
        np.testing.assert_allclose(there["stands"], [9, 4, 0.7])
        # the cone was gone after 0.2 s; it was there at the first frame, so it is before that
        assert ("cone" in there) == (time_s < 0)
        if rule == "continue":
            np.testing.assert_allclose(there["car"][0], 12.0 + 4.0 * time_s)
        elif rule == "hold":
            np.testing.assert_allclose(there["car"][0], 12.0 + 4.0 * np.clip(time_s, -0.25, 0.75), atol=1e-9)
        np.testing.assert_allclose(state.world_from_ego.at(time_s)[0, 3], 5.0 * time_s)
    # in the recording nothing is another
    for time_s in (0.0, 0.31, 0.5):
        before, after = (DriveStates(one, {}).state(time_s, time_s) for one in (parked(DRIVE), drive))
        assert [actor.uid for actor in before.actors] == [actor.uid for actor in after.actors]
        for a, b in zip(before.actors, after.actors, strict=True):
            np.testing.assert_allclose(a.world_from_actor.at(time_s), b.world_from_actor.at(time_s), atol=1e-12)


def test_the_ego_holds_with_its_sensors_and_its_body() -> None:
    stands = parked(DRIVE).actors["stands"]
    body = replace(stands, uid="body", is_ego_body=True, world_from_actor=DRIVE.world_from_ego, is_moving=True)
    drive = replace(DRIVE, actors={**DRIVE.actors, "body": body})
    drive = carried_outside(drive, scenario(outside="hold"), (4_000_000,))
    for trajectory, x in (
        (drive.world_from_ego, 0.0),
        (drive.cameras["front"].world_from_camera, 1.0),
        (drive.lidars["top"].world_from_lidar, 0.0),
        (drive.actors["body"].world_from_actor, 0.0),
    ):
        np.testing.assert_allclose(trajectory.at(4.0)[0, 3], x + 5.0 * 0.75, atol=1e-9)
    assert drive.actors["body"].present(4.0)


def test_an_edits_own_outside_counts_for_its_actor() -> None:
    keys = [{"time_s": 0.0, "position": [0, 5, 1]}, {"time_s": 0.5, "position": [5, 5, 1]}]
    edits = [
        {"type": "insert", "actor": "car", "id": "holds", "trajectory": keys, "outside": "hold"},
        {"type": "insert", "actor": "car", "id": "goes-on", "trajectory": keys, "outside": "continue"},
        {"type": "insert", "actor": "car", "id": "untold", "trajectory": keys},
    ]
    told = scenario(edits=edits, outside={"actors": "absent", "ego": "hold"})
    drive = carried_outside(apply_scenario(told, DRIVE, lambda path: {}), told, (2_000_000,))
    state = DriveStates(drive, {}).state(2.0, 2.0)
    there = {actor.uid: float(actor.world_from_actor.at(2.0)[0, 3]) for actor in state.actors}
    assert there == pytest.approx({"holds": 5.0, "goes-on": 20.0})
