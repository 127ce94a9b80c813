"""How the models move their actors: as recorded, behind others, into the ego's lane, at it, by keys."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recorded_traffic import (
    PERSON,
    actor,
    bend,
    ego_box,
    jumps,
    keys,
    on_log,
    recording,
    run,
    standing,
    straight,
)

from unisim_blender.core.geometry import Trajectory
from unisim_blender.core.simulation.actors.model import Model
from unisim_blender.core.simulation.actors.models import Attack, Auto, CutIn, Idm, Lane, Replay, Scripted
from unisim_blender.core.simulation.actors.models.attack import AttackMemory
from unisim_blender.core.simulation.actors.models.idm import FollowingMemory, RecordedMemory
from unisim_blender.core.simulation.actors.models.scripted import ScriptedKey
from unisim_blender.core.simulation.actors.recording import Recording
from unisim_blender.core.simulation.footprints import time_to_overlap
from unisim_blender.core.simulation.states import Footprint
from unisim_blender.core.world.drive import EGO

FOLLOWER = actor("car", straight(keys(), -20, 0, 10.0))


def street() -> Recording:
    """An ego vehicle and a car 20 m behind it, both at 10 m/s; one parked beside."""
    return recording(straight(keys(), 0, 0, 10.0), FOLLOWER, actor("parked", standing(30, 4)))


def stopping(
    start_s: float, x: float, speed: float, braking: float, leaves_s: float = math.inf
) -> Callable[[int], Footprint]:
    """An ego vehicle that brakes from a time on, and drives on again at once at a later time."""

    def at(time_us: int) -> Footprint:
        t = time_us / 1e6
        since = min(max(t - start_s, 0.0), speed / braking)
        now = speed - braking * since if t >= start_s else speed
        way = speed * min(t, start_s) + speed * since - braking * since**2 / 2 + speed * max(t - leaves_s, 0.0)
        return ego_box(x + way, 0.0, speed if t >= leaves_s else max(now, 0.0))

    return at


@pytest.mark.parametrize("uid", ["car", "van", "late", "person"])
def test_replay_is_the_recorded_trajectory_to_the_bit(uid: str) -> None:
    times = keys(10, 0.1)
    world = recording(
        straight(times, 0, 0, 10.0),
        actor("car", bend(times, 12, 1, 5.0, 0.4)),
        actor("van", standing(30, -4, 0.3)),
        actor("late", bend(times[30:61], 20, 4, 9.0, -0.3)),
        actor("person", bend(times, 15, 5, 1.3, 0.2), "Pedestrian", PERSON),
    )
    one = world.actors[uid]
    result = run(world, {uid: Replay()}, on_log(world), step_us=70_000)
    start, end = world.windows_s[uid]
    for time_us, state in zip(result.times_us, result.states(uid), strict=True):
        assert state.pose.tobytes() == one.world_from_actor.at(time_us / 1e6).tobytes()
        assert state.present == (start <= time_us / 1e6 <= end)
    if uid == "car":
        np.testing.assert_allclose(result.column(uid, "speed_m_s")[4:-4], 5.0, rtol=3e-3)


def test_auto_takes_no_step_of_the_driver_model_while_the_ego_follows_its_log() -> None:
    """Though the recorded boxes would meet if all went straight on: one comes towards a bend, one is close behind."""
    times = keys()
    behind = bend(times - 0.8, 0, 0, 10.0, 0.2)
    world = recording(
        bend(times, 0, 0, 10.0, 0.2),
        actor("oncoming", bend(times, 53.5 * math.sin(2), 50 - 53.5 * math.cos(2), 10.0, -10 / 53.5, 2 + math.pi)),
        actor("close", Trajectory(times, behind.positions, behind.quaternions_wxyz)),
        actor("person", bend(times, 20, 5, 1.3, 0.2), "Pedestrian", PERSON),
    )
    models: dict[str, Model] = {"oncoming": Auto(), "close": Lane(), "person": Auto()}
    result = run(world, models, on_log(world))
    for uid in models:
        for time_us, state in zip(result.times_us, result.states(uid), strict=True):
            assert state.pose.tobytes() == world.actors[uid].world_from_actor.at(time_us / 1e6).tobytes()
        assert all(isinstance(motion.memory, RecordedMemory) for motion in result.motions[uid])
    boxes = [seen.by_uid for seen in result.traffic]
    assert any(time_to_overlap(seen["oncoming"], seen[EGO], 3.0) is not None for seen in boxes)


def test_auto_follows_when_the_ego_leaves_its_log_and_does_not_jump() -> None:
    world = street()
    result = run(world, {"car": Auto(), "parked": Auto()}, stopping(2.0, 0.0, 10.0, 4.0), seconds=20)
    following = [isinstance(motion.memory, FollowingMemory) for motion in result.motions["car"]]
    first = following.index(True)
    assert all(following[first:])
    # the ego is 1 m off after sqrt(2 / 4) s of braking: 2.71 s, seen at 2.8 s
    assert result.times_us[first - 1] == 2_800_000
    assert jumps(result, "car").max() < 1e-6
    speeds = result.column("car", "speed_m_s")
    assert np.abs(np.diff(speeds)).max() < 0.8 + 1e-9
    assert speeds[first - 1] == pytest.approx(10.0)
    gaps = np.array([seen.ego.x_m for seen in result.traffic]) - 2.4 - (result.column("car", "x") + 2.25)
    assert gaps.min() > 0.9 and speeds[-1] == pytest.approx(0.0, abs=0.02) and gaps[-1] == pytest.approx(1.0, abs=0.05)
    assert {state.position_m for state in result.states("parked")} == {(30.0, 4.0, 0.75)}


def test_auto_foresees_a_conflict_before_the_ego_is_a_metre_off() -> None:
    """The ego stands from the start 0.6 m ahead of its log, which another passes closely: no conflict. With its rear in the
    way of a car that comes, there is one within 3 s."""
    times = keys()
    ego = straight(times, 0.0, 0.0, 0.0)
    coming = actor("car", straight(times, 60.0, 2.3, 10.0, math.pi))  # passes 0.35 m beside the ego's box
    world = recording(ego, coming)
    for x, y, switches in ((0.6, 0.0, False), (0.0, 0.6, True), (0.0, 0.2, False)):
        result = run(world, {"car": Auto()}, lambda _, x=x, y=y: ego_box(x, y), seconds=8)  # type: ignore[misc]
        following = [isinstance(motion.memory, FollowingMemory) for motion in result.motions["car"]]
        assert any(following) == switches
        if switches:
            seen = result.traffic[following.index(True) - 1].by_uid["car"]
            assert seen.x_m - 2.25 - 2.4 == pytest.approx(30.0, abs=1.0)  # 3 s at 10 m/s, on a grid of 1 m
            assert jumps(result, "car").max() < 1e-6
            assert result.column("car", "x").min() > 0.6 + 2.4 + 2.25 - 0.6


@pytest.mark.parametrize("step_us", [50_000, 100_000, 500_000])
def test_idm_keeps_its_distance_never_goes_back_and_goes_on(step_us: int) -> None:
    world = street()
    result = run(world, {"car": Idm()}, stopping(2.0, 0.0, 10.0, 5.0, leaves_s=20.0), seconds=40, step_us=step_us)
    x, speeds = result.column("car", "x"), result.column("car", "speed_m_s")
    assert (np.diff(x) >= 0).all() and (speeds >= 0).all()
    gaps = np.array([seen.ego.x_m for seen in result.traffic]) - 2.4 - (x + 2.25)
    assert gaps.min() > 0.9
    at = result.times_us.index(19_500_000)
    assert speeds[at] == pytest.approx(0.0, abs=0.05) and gaps[at] == pytest.approx(1.0, abs=0.1)
    assert speeds[-1] > 8.0  # it has gone on, at the speed that was recorded, as far as it has come
    assert jumps(result, "car").max() < 1e-6
    accelerations = result.column("car", "acceleration_m_s2")
    assert accelerations.min() > -8.0 and accelerations.max() <= 1.0 + 1e-9


def test_idm_reaches_the_recorded_speed_of_each_place() -> None:
    """On a free road along a record that is slower in its middle: from 60 m on it brakes, and drives 4 m/s from 82 to 106 m."""
    times = keys(20)
    speed = np.interp(times, [6, 10, 14, 20], [10, 4, 4, 10])
    world = recording(straight(times, 0, -30, 10.0), actor("car", straight(times, 0, 0, speed)), seconds=20)
    result = run(world, {"car": Idm()}, on_log(world), seconds=20)
    path = world.paths["car"]
    assert path is not None
    x, speeds = result.column("car", "x"), result.column("car", "speed_m_s")
    within = (x > 97) & (x < 102)
    assert within.any() and np.abs(speeds[within] - 4.0).max() < 0.3
    assert speeds[x < 55].min() > 9.5 and speeds[-1] > 6.5


def test_idm_stands_where_and_until_when_the_recording_stood() -> None:
    """At a red light that the recording waited at from 4 s to 9 s; and for good where the record ends at rest."""
    times = keys(20)
    speed = np.interp(times, [0, 2, 4, 9, 12, 15, 18, 20], [8, 8, 0, 0, 8, 8, 0, 0])
    world = recording(straight(times, 0, -30, 10.0), actor("car", straight(times, 0, 0, speed)), seconds=20)
    result = run(world, {"car": Idm()}, on_log(world), seconds=60)
    x, t = result.column("car", "x"), np.array(result.times_us) / 1e6
    stop, end = 24.0, float(world.actors["car"].world_from_actor.positions[-1, 0])
    assert x[t <= 9.0].max() < stop + 0.5 and x[t == 9.0][0] > stop - 1.5
    assert x[t == 14.0][0] > stop + 3
    assert end - 1.0 < x[-1] < end + 0.5


def test_idm_comes_late_to_a_stop_that_the_recording_has_left() -> None:
    """Held up by the ego for twenty seconds, it does not wait at the light again."""
    times = keys(20)
    speed = np.interp(times, [0, 4, 6, 9, 12, 20], [8, 8, 0, 0, 8, 8])
    world = recording(straight(times, 0, -30, 10.0), actor("car", straight(times, 0, 0, speed)), seconds=20)

    def ego(time_us: int) -> Footprint:
        return ego_box(15.0, 0.0 if time_us < 25_000_000 else 50.0)

    result = run(world, {"car": Idm()}, ego, seconds=45)
    x, t = result.column("car", "x"), np.array(result.times_us) / 1e6
    assert x[t == 25.0][0] < 12.0
    moving = result.column("car", "speed_m_s")[t > 27.0]
    assert moving.min() > 0.8 and x[-1] > 80


def test_idm_goes_straight_on_at_the_end_or_leaves_with_its_track() -> None:
    times = keys()
    world = recording(
        straight(times, 0, -30, 10.0),
        actor("on", straight(times, 0, 0, 10.0)),
        actor("left", straight(times[:51], 0, 8, 10.0)),
    )
    result = run(world, {"on": Idm(), "left": Idm()}, on_log(world), seconds=10)
    assert result.column("on", "present").all()
    assert result.column("left", "present").tolist() == [True] * 51 + [False] * 50
    longer = run(world, {"on": Idm()}, lambda _: ego_box(0, -60), seconds=15)
    assert longer.column("on", "x")[-1] == pytest.approx(150, abs=1) and longer.column("on", "present").all()


def test_an_actor_appears_when_its_place_is_free() -> None:
    times = keys()
    world = recording(straight(times, -50, 0, 2.0), actor("car", straight(times[20:], 0, 0, 5.0)))

    def ego(time_us: int) -> Footprint:
        return ego_box(0.0 if time_us < 5_000_000 else 40.0, 0.0)

    for model in (Idm(), Auto()):
        result = run(world, {"car": model}, ego, seconds=8)
        present, t = result.column("car", "present"), np.array(result.times_us) / 1e6
        assert present.tolist() == (t > 5.0).tolist()
        assert result.column("car", "x")[present][0] == pytest.approx(0.0)
    free = run(world, {"car": Idm()}, lambda _: ego_box(0.0, 30.0), seconds=8)
    assert free.column("car", "present").tolist() == (np.array(free.times_us) >= 2_000_000).tolist()


def test_labels_that_overlap_in_the_recording_stop_nobody() -> None:
    """A parked car whose box the recorded path goes through; the ego in the same place stops it."""
    times = keys()
    car, parked = actor("car", straight(times, 0, 0, 8.0)), actor("parked", standing(40, 1.8))
    world = recording(straight(times, 0, -30, 8.0), car, parked)
    result = run(world, {"car": Idm(), "parked": Replay()}, on_log(world))
    assert result.column("car", "x")[-1] == pytest.approx(80, abs=1.0)
    stopped = run(world, {"car": Idm()}, lambda _: ego_box(40, 1.8), seconds=30)
    assert stopped.column("car", "x")[-1] < 36


def test_two_behind_each_other_do_not_both_stand() -> None:
    """Boxes that overlap from the start: the front one drives off, the rear one waits for it."""
    times = keys()
    world = recording(
        straight(times, 0, -30, 8.0),
        actor("front", straight(times, 3, 0, 6.0)),
        actor("rear", straight(times, 0, 0, 6.0)),
    )
    result = run(world, {"front": Idm(), "rear": Idm()}, on_log(world))
    gap = result.column("front", "x") - result.column("rear", "x") - 4.5
    assert gap[0] < 0 and gap[-1] > 3 and jumps(result, "rear").max() < 1e-6


def test_lane_goes_on_where_the_record_ends() -> None:
    times = keys()
    world = recording(
        straight(times, 0, -60, 10.0),
        actor("short", straight(times[:31], 0, 0, 10.0)),
        actor("long", bend(times, 20, 0.6, 10.0, 0.08)),
    )
    result = run(world, {"short": Lane()}, on_log(world), seconds=9)
    x, y = result.column("short", "x"), result.column("short", "y")
    for time_us, state in list(zip(result.times_us, result.states("short"), strict=True))[:31]:
        assert state.pose.tobytes() == world.actors["short"].world_from_actor.at(time_us / 1e6).tobytes()
    assert result.column("short", "present").all()
    assert jumps(result, "short").max() < 1e-3
    headings = np.unwrap([state.heading_rad for state in result.states("short")])
    assert np.abs(np.diff(headings)).max() < 0.15
    lane = world.paths["long"]
    assert lane is not None and lane.project(float(x[-1]), float(y[-1]))[1] == pytest.approx(0.0, abs=1e-6)
    assert y[-1] > 10
    alone = recording(straight(times, 0, -60, 10.0), actor("short", straight(times[:31], 0, 0, 10.0)))
    on = run(alone, {"short": Lane()}, on_log(alone), seconds=9)
    assert on.column("short", "x")[-1] == pytest.approx(90.0, abs=0.5) and np.ptp(on.column("short", "y")) == 0


@pytest.mark.parametrize(("duration", "difference"), [(2.0, -2.0), (4.0, 1.0), (3.0, 0.0)])
def test_cut_in(duration: float, difference: float) -> None:
    """From the left lane, 3.5 m aside, past an ego at 10 m/s: when there are 8 m between them it changes."""
    times = keys(30)
    world = recording(straight(times, 0, 0, 10.0), actor("car", straight(times, 5, 3.5, 12.0)), seconds=30)
    model = CutIn(cut_in_gap_m=8.0, cut_in_headway_s=1.5, duration_s=duration, speed_difference_m_s=difference)
    result = run(world, {"car": model}, lambda t: ego_box(10e-6 * t, 0.0, 10.0), seconds=9.5)
    x, y, t = result.column("car", "x"), result.column("car", "y"), np.array(result.times_us) / 1e6
    gap = x - 10.0 * t - 4.65
    changing = [
        isinstance(motion.memory, FollowingMemory) and motion.memory.stage == 1 for motion in result.motions["car"]
    ]
    first = changing.index(True)
    assert 8.0 <= gap[first - 1] < 8.3
    assert y[:first].tolist() == [3.5] * first
    done = t[np.flatnonzero(np.abs(y) < 0.01)[0]] - t[first - 1]
    assert done == pytest.approx(duration, rel=0.15)
    assert y[-1] == pytest.approx(0.0, abs=1e-9)
    assert result.column("car", "speed_m_s")[-1] == pytest.approx(10.0 + difference, abs=0.2)
    assert jumps(result, "car").max() < 1e-3
    headings = np.array([state.heading_rad for state in result.states("car")])
    assert np.abs(np.diff(headings)).max() < 0.2 and headings[-1] == pytest.approx(0.0, abs=1e-9)
    middle = y[np.argmin(np.abs(t - t[first - 1] - done / 2))]
    assert 1.0 < middle < 2.5  # a quintic passes the middle at half the way


def test_cut_in_goes_where_the_ego_is_not_where_its_log_is() -> None:
    times = keys(30)
    world = recording(straight(times, 0, 0, 10.0), actor("car", straight(times, -10, 3.5, 12.0)), seconds=30)
    result = run(world, {"car": CutIn()}, lambda t: ego_box(10e-6 * t, -0.8, 10.0), seconds=25)
    assert result.column("car", "y")[-1] == pytest.approx(-0.8, abs=1e-6)


@pytest.mark.parametrize(
    ("start", "aside", "speed"), [(40, 3.5, 10.0), (-30, 3.5, 10.0), (9, 20.0, 10.0), (0, 3.5, 0.0)]
)
def test_cut_in_waits_for_its_time(start: float, aside: float, speed: float) -> None:
    """Too far ahead, behind, too far aside, or an ego that stands: it replays."""
    times = keys()
    world = recording(straight(times, 0, 0, speed), actor("car", straight(times, start, aside, max(speed, 1.0))))
    result = run(world, {"car": CutIn()}, on_log(world))
    assert all(isinstance(motion.memory, RecordedMemory) for motion in result.motions["car"])


def attacked(seed: int, seconds: float = 8.0) -> tuple[list[tuple[float, ...]], float, float]:
    """The attacker's poses, the least distance of the boxes' middles, and the largest jump."""
    times = keys()
    world = recording(
        straight(times, 0, 0, 8.0),
        actor("car", straight(times, 30, 3.5, 8.0)),
        actor("other", straight(times, 30, 7.0, 8.0)),
        seed=seed,
    )
    result = run(world, {"car": Attack(), "other": Replay()}, lambda t: ego_box(8e-6 * t, 0.0, 8.0), seconds=seconds)
    poses: list[tuple[float, ...]] = [
        (*state.position_m, *state.quaternion_wxyz, state.speed_m_s) for state in result.states("car")
    ]
    ego = np.array([(seen.ego.x_m, seen.ego.y_m) for seen in result.traffic])
    near = np.hypot(result.column("car", "x") - ego[:, 0], result.column("car", "y") - ego[:, 1]).min()
    assert all(isinstance(motion.memory, AttackMemory) for motion in result.motions["car"][1:])
    return poses, float(near), float(jumps(result, "car").max())


def test_attack_is_seeded_hits_and_does_not_jump() -> None:
    first = attacked(1)
    assert attacked(1) == first
    others = [attacked(seed) for seed in range(2, 5)]
    assert len({tuple(poses) for poses, _, _ in others}) == 3
    for _, near, jump in (first, *others):
        assert near < 3.5 and jump < 1e-6  # beside it at first, 30 m ahead: it comes until the boxes touch


def test_attack_turns_no_tighter_than_a_car_and_stops_when_it_has_hit() -> None:
    poses, _, _ = attacked(3, seconds=20.0)
    places, speeds = np.array([pose[:2] for pose in poses]), np.array([pose[-1] for pose in poses])
    headings = np.unwrap([2 * math.atan2(pose[6], pose[3]) for pose in poses])
    way = np.linalg.norm(np.diff(places, axis=0), axis=1)
    moving = way > 0.05
    assert (np.abs(np.diff(headings))[moving] / way[moving]).max() < 0.2 + 1e-3
    assert np.abs(np.diff(speeds)).max() < 0.8 + 1e-9
    assert speeds[-1] == 0.0


def test_attack_leaves_alone_what_is_far_away() -> None:
    times = keys()
    world = recording(straight(times, 0, 0, 8.0), actor("car", straight(times, 80, 3.5, 8.0)))
    result = run(world, {"car": Attack(range_m=60.0)}, on_log(world))
    assert all(isinstance(motion.memory, RecordedMemory) for motion in result.motions["car"])


def test_scripted_speeds_and_places_aside() -> None:
    """From the recorded 10 m/s to 4 m/s at 4 s and on to 8 s, then 3 m to the left until 12 s."""
    times = keys()
    world = recording(straight(times, 0, -30, 10.0), actor("car", straight(times, 0, 0, 10.0)))
    script = Scripted((ScriptedKey(4.0, speed_m_s=4.0), ScriptedKey(8.0, left_m=0.0), ScriptedKey(12.0, left_m=3.0)))
    result = run(world, {"car": script}, on_log(world), seconds=9)
    x, t = result.column("car", "x"), np.array(result.times_us) / 1e6
    expected = np.where(t < 4, 10 * t - 0.75 * t**2, 28 + 4 * (t - 4))
    np.testing.assert_allclose(x, expected, atol=1e-6)
    assert result.column("car", "speed_m_s")[20] == pytest.approx(7.0)
    assert result.column("car", "acceleration_m_s2")[20] == pytest.approx(-1.5)
    later = run(world, {"car": script}, lambda _: ego_box(0, -30), seconds=16)
    y = later.column("car", "y")
    assert y[80] == pytest.approx(0.0) and y[100] == pytest.approx(1.5) and y[120] == y[-1] == pytest.approx(3.0)
    assert jumps(later, "car").max() < 1e-2
    assert later.states("car")[100].heading_rad == pytest.approx(math.atan2(3.0 / 4 * 1.875, 4.0), abs=1e-6)


def test_scripted_aside_alone_keeps_the_recorded_speed() -> None:
    times = keys()
    world = recording(straight(times, 0, -30, 10.0), actor("car", bend(times, 0, 0, 10.0, 0.1)))
    result = run(world, {"car": Scripted((ScriptedKey(0.0, left_m=1.5),))}, on_log(world))
    for time_us, state in zip(result.times_us, result.states("car"), strict=True):
        recorded = world.actors["car"].world_from_actor.at(time_us / 1e6)
        np.testing.assert_allclose(state.position_m, recorded[:3, 3] + 1.5 * recorded[:3, 1], atol=1e-9)


def test_a_parked_car_drives_off_by_its_script() -> None:
    world = recording(straight(keys(), 0, -30, 10.0), actor("car", standing(5, 5, math.pi / 2)))
    result = run(
        world,
        {"car": Scripted((ScriptedKey(2.0, speed_m_s=0.0), ScriptedKey(6.0, speed_m_s=8.0)))},
        on_log(world),
        seconds=8,
    )
    y = result.column("car", "y")
    assert y[20] == pytest.approx(5.0) and y[60] == pytest.approx(21.0) and y[-1] == pytest.approx(37.0)
    assert jumps(result, "car").max() < 1e-6


def test_the_result_of_a_script_does_not_depend_on_the_steps() -> None:
    world = street()
    script = Scripted((ScriptedKey(1.3, speed_m_s=2.0), ScriptedKey(2.7, speed_m_s=9.0, left_m=1.0)))
    fine = run(world, {"car": script}, on_log(world), step_us=20_000)
    coarse = run(world, {"car": script}, on_log(world), step_us=500_000)
    assert coarse.states("car") == fine.states("car")[::25]


WALK = straight(keys(), 20, -6, 1.4, math.pi / 2)


@pytest.mark.parametrize("model", [Replay(), Idm(), Auto(), Lane(), CutIn(), Attack()], ids=lambda model: model.type)
def test_a_pedestrian_stops_before_a_box_in_its_way_and_walks_on(model: Model) -> None:
    """The recorded ego passes before it comes; this one stands in the way until 8 s."""
    walker = actor("person", WALK, "Pedestrian", PERSON)
    world = recording(straight(keys(), 0, 0, 10.0), walker)

    def ego(time_us: int) -> Footprint:
        return ego_box(20.0, 0.0) if time_us <= 8_000_000 else ego_box(40.0, 0.0)

    result = run(world, {"person": model}, ego, seconds=14)
    y, t = result.column("person", "y"), np.array(result.times_us) / 1e6
    stands = y[t == 7.0][0]
    assert -1.0 - 0.3 - 1.2 < stands < -1.0 - 0.3 - 0.3  # the ego's side is at -1 m, half a person 0.3 m
    assert y[t == 8.0][0] == stands and result.column("person", "speed_m_s")[t == 8.0][0] == 0
    assert (np.diff(y) >= 0).all() and jumps(result, "person").max() < 0.02
    assert y[-1] - y[t == 10.0][0] == pytest.approx(4 * 1.4, abs=0.01)
    assert result.column("person", "present").all()  # it walks its whole way, later
    on = run(world, {"person": model}, on_log(world))
    for time_us, state in zip(on.times_us, on.states("person"), strict=True):
        assert state.pose.tobytes() == walker.world_from_actor.at(time_us / 1e6).tobytes()


def test_a_pedestrian_does_not_mind_what_was_there_when_it_was_recorded() -> None:
    """A parked car whose box it brushes in the recording, even when it is late."""
    parked = actor("parked", standing(20.4, -1.0))
    walker = actor("person", WALK, "Pedestrian", PERSON)
    world = recording(straight(keys(), 0, 30, 10.0), walker, parked)
    models: dict[str, Model] = {"person": Replay(), "parked": Replay()}
    result = run(world, models, on_log(world))
    assert result.column("person", "y")[-1] == pytest.approx(8.0)

    def ego(time_us: int) -> Footprint:
        return ego_box(20.0, -3.5 if time_us <= 3_000_000 else 30.0)

    late = run(world, models, ego, seconds=14)
    assert late.column("person", "y")[30] < -4.8 and late.column("person", "y")[-1] > 7.0


def test_a_rider_stops_in_time() -> None:
    """Someone on a bicycle at 6 m/s needs 6 m."""
    rider = actor("rider", straight(keys(), -20, 0, 6.0), "BICYCLIST", np.array([1.8, 0.6, 1.7]))
    world = recording(straight(keys(), 0, 30, 6.0), rider)
    result = run(world, {"rider": Replay()}, lambda _: ego_box(10.0, 0.0), seconds=10)
    x, speeds = result.column("rider", "x"), result.column("rider", "speed_m_s")
    assert 10 - 2.4 - 0.9 - 2.5 < x[-1] < 10 - 2.4 - 0.9 - 0.2 and speeds[-1] == 0
    assert np.diff(speeds).min() > -0.4 and jumps(result, "rider").max() < 0.02


@pytest.mark.parametrize("model", [Idm(), Auto(), Lane(), CutIn(), Attack(), Replay()], ids=lambda model: model.type)
def test_the_same_again_is_the_same_to_the_bit(model: Model) -> None:
    def states() -> list[object]:
        world = replace(street(), seed=7)
        return list(run(world, {"car": model}, stopping(1.0, 0.0, 10.0, 5.0), seconds=15).states("car"))

    assert states() == states()
