"""Recorded trajectories by arc length, and paths that come to other paths.

Nothing jumps: in random scenes no box moves further in a step than its speed allows, whatever its model. Points along a
polyline and beside it are held against places sampled along it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_traffic import PERSON, actor, bend, ego_box, jumps, keys, recording, run, standing, straight

from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.simulation.actors.lead import Way, swept
from unisim_blender.core.simulation.actors.model import Model
from unisim_blender.core.simulation.actors.models import Attack, Auto, CutIn, Idm, Lane, Replay, Scripted
from unisim_blender.core.simulation.actors.models.scripted import ScriptedKey
from unisim_blender.core.simulation.states import Footprint
from unisim_blender.core.world.actor_path import ActorPath, joined, yaw_of
from unisim_blender.core.world.polyline import Polyline, spaced


def path_of(trajectory: Trajectory) -> ActorPath:
    path = ActorPath.recorded(trajectory, float(trajectory.times_s[0]), float(trajectory.times_s[-1]), False)
    assert path is not None
    return path


def tilted(trajectory: Trajectory) -> Trajectory:
    """The trajectory up a slope, pitched and rolled."""
    poses = trajectory.poses
    pitch, roll = np.array([math.cos(-0.05), 0, math.sin(-0.05), 0]), np.array([math.cos(0.02), math.sin(0.02), 0, 0])
    poses = poses @ make_pose(np.zeros(3), pitch) @ make_pose(np.zeros(3), roll)
    poses[:, 2, 3] += 0.1 * poses[:, 0, 3]
    return Trajectory.from_poses(trajectory.times_s, poses)


def test_a_pose_by_arc_length_is_the_recorded_one() -> None:
    """Position and the whole rotation, at any time."""
    trajectory = tilted(bend(keys(5), 3, 4, 8.0, 0.3))
    path = path_of(trajectory)
    for time in np.linspace(0, 5, 77):
        position, quaternion = path.place(path.s_at_time(float(time)))
        pose = make_pose(np.array(position), np.array(quaternion))
        np.testing.assert_allclose(pose, trajectory.at(time), atol=1e-9)


def test_length_curvature_and_speed_of_an_arc() -> None:
    path = path_of(bend(keys(5), 0, 0, 8.0, 0.2))
    assert path.length_m == pytest.approx(40.0, rel=1e-4)  # chords of 0.02 rad
    assert path.curvature_at(12.3) == pytest.approx(0.2 / 8, rel=1e-3)
    assert path.speed_at(20.0) == pytest.approx(8.0, rel=1e-3)


@pytest.mark.parametrize("first_m", [-2.0, 0.0, 3.7, 38.0, 55.0])
def test_a_sweep_interpolates_linearly_between_keys(first_m: float) -> None:
    path = path_of(tilted(bend(keys(5), 0, 0, 8.0, 0.2)))
    far = path.place(path.length_m + 1000.0)
    s = np.append(path.s_m, path.length_m + 1000.0)
    poses = swept([Way(path, first_m, 20.0, 0.7)])
    np.testing.assert_allclose(poses.s_m, first_m + 0.7 * np.arange(len(poses.s_m)))
    assert poses.s_m[-1] >= first_m + 20.0
    for found, keyed, end in (
        (poses.x_m, path.positions[:, 0], far[0][0]),
        (poses.y_m, path.positions[:, 1], far[0][1]),
    ):
        np.testing.assert_allclose(found, np.interp(poses.s_m, s, np.append(keyed, end)), atol=1e-9)
    headings = np.append(path.headings_rad, path.headings_rad[-1])
    np.testing.assert_allclose(poses.heading_rad, np.interp(poses.s_m, s, headings), atol=1e-12)
    for one in (first_m, 12.3, path.length_m, path.length_m + 3):
        assert path.point(one) == path.place(one)[0][:2]


def test_straight_on_beyond_the_end() -> None:
    """In the direction of the last heading and up the last slope, without a bend or a step."""
    path = path_of(tilted(bend(keys(5), 0, 0, 8.0, 0.2)))
    end, beyond = path.place(path.length_m), path.place(path.length_m + 50)
    moved = np.subtract(beyond[0], end[0])
    heading = float(yaw_of(np.array(end[1])))
    assert math.hypot(moved[0], moved[1]) == pytest.approx(50.0)
    assert math.atan2(moved[1], moved[0]) == pytest.approx(heading)
    assert beyond[1] == end[1]
    assert 0 < moved[2] / 50 < 0.2
    assert path.curvature_at(path.length_m + 1) == 0


def test_the_steepest_slope_is_bounded() -> None:
    times = keys(5)
    up = straight(times, 0, 0, 5.0)
    climbing = Trajectory(times, up.positions + times[:, None] * [0, 0, 10.0], up.quaternions_wxyz)
    path = path_of(climbing)
    assert path.place(path.length_m + 10)[0][2] - path.place(path.length_m)[0][2] == pytest.approx(2.0)


def test_a_point_beside_the_path() -> None:
    trajectory = bend(keys(5), 0, 0, 8.0, 0.2)
    path = path_of(trajectory)
    for s, left in ((3.0, 2.0), (17.7, -4.0), (39.0, 0.5)):
        position, quaternion = path.place(s)
        heading = float(yaw_of(np.array(quaternion)))
        found = path.project(position[0] - left * math.sin(heading), position[1] + left * math.cos(heading))
        assert found == pytest.approx((s, left), abs=0.1)
    end, _ = path.place(path.length_m)
    assert path.project(*path.place(path.length_m + 30)[0][:2]) == pytest.approx((path.length_m + 30, 0.0), abs=1e-6)


def test_what_labels_wander_while_it_stands_is_no_way() -> None:
    """A car that stands for six seconds with labels 3 cm off, and drives before and after."""
    times, rng = keys(), np.random.default_rng(0)
    speed = np.where((times < 2) | (times >= 8), 6.0, 0.0)
    clean = straight(times, 0, 0, speed)
    noisy = Trajectory(times, clean.positions + rng.normal(0, 0.03, (len(times), 3)), clean.quaternions_wxyz)
    path = path_of(noisy)
    assert path.length_m == pytest.approx(24.0, abs=0.5)
    (stop,) = path.stops
    assert stop.s_m == pytest.approx(12.0, abs=0.25)
    assert stop.leave_s == pytest.approx(8.0, abs=0.11)


def test_where_it_stood_and_until_when() -> None:
    times = keys()
    path = path_of(straight(times, 0, 0, np.where((times < 3) | (times > 7), 0.0, 5.0)))
    assert [(round(stop.s_m, 6), stop.leave_s) for stop in path.stops] == [
        (0.0, pytest.approx(3.0, abs=0.06)), (round(path.length_m, 6), math.inf),
    ]  # fmt: skip


def test_what_stands_has_no_path() -> None:
    rng = np.random.default_rng(0)
    times = keys()
    still = straight(times, 5, 5, 0.0)
    noisy = Trajectory(times, still.positions + rng.normal(0, 0.03, (len(times), 3)), still.quaternions_wxyz)
    assert ActorPath.recorded(noisy, 0.0, 10.0, False) is None
    assert ActorPath.recorded(standing(1, 2), 0.0, 10.0, False) is None


def test_backward() -> None:
    """A box that moves against its heading: the path goes the way it went, and on so beyond its end."""
    times = keys(4)
    reversing = Trajectory(
        times, np.stack([-2 * times, 0 * times, 0 * times], -1), np.broadcast_to([1.0, 0, 0, 0], (len(times), 4))
    )
    path = path_of(reversing)
    assert path.gear_at(3.0) == -1
    assert path.place(path.length_m + 2)[0][0] == pytest.approx(-10.0)


@pytest.mark.parametrize("left", [3.5, -2.0, 0.0])
@pytest.mark.parametrize("turn", [0.0, 0.3, -0.5])
def test_a_join_starts_at_its_pose_and_ends_on_the_path(left: float, turn: float) -> None:
    """Positions and headings have no step, and headings are those of the way."""
    lane = path_of(bend(keys(10), 0, 0, 10.0, 0.05))
    (x, y, z), quaternion = lane.place(20.0)
    heading = float(yaw_of(np.array(quaternion)))
    position = x - left * math.sin(heading), y + left * math.cos(heading), z + 0.3
    w, i, j, k = quaternion_from_yaw(heading + turn).tolist()
    path = joined(lane, 20.0, position, (w, i, j, k), 30.0)
    assert path.place(0.0) == (position, (w, i, j, k))
    for beyond in (0.0, 5.0, 20.0):
        s, aside = lane.project(*path.place(path.length_m - beyond)[0][:2])
        assert aside == pytest.approx(0.0, abs=1e-6)
    at = np.linspace(0, 60, 601)
    places = np.array([path.place(float(s))[0] for s in at])
    headings = path.headings_at(at)
    steps = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.1, atol=1e-3)
    assert np.abs(np.diff(headings)).max() < 0.02
    moving = np.unwrap(np.arctan2(np.diff(places[:, 1]), np.diff(places[:, 0])))
    turned = np.abs((moving - (headings[1:] + headings[:-1]) / 2 + np.pi) % (2 * np.pi) - np.pi)
    assert turned.max() < 0.06  # the distance aside bends with the lane
    assert np.abs(np.diff(places[:, 2])).max() < 0.01 and places[-1, 2] == pytest.approx(z)


def test_a_join_to_the_left_of_a_path() -> None:
    lane = path_of(straight(keys(10), 0, 0, 10.0))
    path = joined(lane, 10.0, (10.0, 3.5, 0.75), (1.0, 0, 0, 0), 20.0, left_m=-1.0)
    assert path.place(25.0)[0][1] == pytest.approx(-1.0)
    middle = path.place(path.project(20.0, 1.25)[0])[0]
    assert middle == pytest.approx((20.0, 1.25, 0.75), abs=0.01)  # a quintic is half way at half time


def test_a_lane_goes_on_along_another_recorded_path() -> None:
    """A track that ends early, one that passes there 0.8 m aside and then turns left, and one that comes the other way."""
    times = keys()
    short = actor("short", straight(keys(3), 0, 0, 10.0))
    turning = actor("turning", bend(times, 20, 0.8, 10.0, 0.1, z=0.9))
    oncoming = actor("oncoming", straight(times, 90, 0.2, 10.0, math.pi))
    world = recording(straight(times, 0, -20, 10.0), short, turning, oncoming)
    path = world.continued("short")
    assert path is not None
    own = world.paths["short"]
    assert own is not None
    for s in np.linspace(0, own.length_m, 20):
        assert path.place(float(s))[0] == pytest.approx(own.place(float(s))[0], abs=1e-9)
    lane = world.paths["turning"]
    assert lane is not None
    s, left = lane.project(*path.place(own.length_m + 40)[0][:2])
    assert left == pytest.approx(0.0, abs=1e-6)
    at = np.arange(0, path.length_m, 0.1)
    places = np.array([path.place(float(s))[0] for s in at])
    np.testing.assert_allclose(np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1), 0.1, atol=1e-3)
    assert np.abs(np.diff(path.headings_at(at))).max() < 0.02
    assert np.ptp(places[:, 2]) < 1e-9  # its own height above the road, not the other's


def test_stops_are_kept_through_a_join() -> None:
    times = keys()
    lane = path_of(straight(times, 0, 0, np.where((times < 4) | (times > 7), 8.0, 0.0)))
    (stop,) = lane.stops
    path = joined(lane, 10.0, (10.0, 0.0, 0.75), (1.0, 0, 0, 0), 5.0)
    (kept,) = path.stops
    assert kept.s_m == pytest.approx(stop.s_m - 10.0) and kept.leave_s == stop.leave_s
    assert joined(lane, 40.0, (40.0, 0.0, 0.75), (1.0, 0, 0, 0), 5.0).stops == ()


SECONDS = 8.0
WINDOW_M = 0.05
"""A recorded speed is a mean over half a second: with up to 2 m/s² a box moves this much further in a step of 0.1 s."""


def of_speeds(rng: np.random.Generator) -> FloatArray:
    """A speed at each key: smooth, at times standing."""
    times = keys(SECONDS)
    start, change = rng.uniform(0, 14), rng.uniform(-2, 2)
    return np.clip(start + change * times, 0, 15)


def trajectory(rng: np.random.Generator) -> Trajectory:
    """Straight at a changing speed, or a bend, or standing."""
    x, y, heading = rng.uniform(-40, 60), rng.uniform(-8, 8), rng.choice([0.0, 0.0, math.pi, math.pi / 2, 0.3])
    kind = rng.integers(5)
    if kind == 0:
        return standing(x, y, heading)
    if kind == 1:
        return bend(keys(SECONDS), x, y, rng.uniform(2, 12), rng.uniform(0.02, 0.3) * rng.choice([-1, 1]), heading)
    whole = straight(keys(SECONDS), x, y, of_speeds(rng), heading)
    first, end = sorted(rng.choice(len(whole.times_s), 2, replace=False).tolist()) if kind == 2 else (0, 80)
    part = slice(first, max(end, first + 2) + 1)
    return Trajectory(whole.times_s[part], whole.positions[part], whole.quaternions_wxyz[part])


@given(st.integers(0, 2**32 - 1), st.sampled_from([50_000, 100_000, 250_000]))
@settings(max_examples=25, deadline=None)
def test_nothing_jumps(seed: int, step_us: int) -> None:
    rng = np.random.default_rng(seed)
    kinds: list[Model] = [
        Idm(), Auto(), Lane(), CutIn(cut_in_headway_s=4.0), Attack(), Replay(),
        Scripted((ScriptedKey(2.0, speed_m_s=6.0), ScriptedKey(5.0, speed_m_s=0.0))),
    ]  # fmt: skip
    actors = [actor(f"a{index}", trajectory(rng)) for index in range(8)]
    actors += [actor("person", trajectory(rng), "Pedestrian", PERSON)]
    world = recording(straight(keys(SECONDS), 0, 0, of_speeds(rng)), *actors, seconds=SECONDS, seed=seed)
    models = {one.uid: kinds[rng.integers(len(kinds))] for one in actors}
    speed, aside, drift = rng.uniform(0, 12), rng.uniform(-4, 4), rng.uniform(-0.5, 0.5)

    def ego(time_us: int) -> Footprint:
        t = time_us / 1e6
        return ego_box(speed * t, aside + drift * t, speed)

    result = run(world, models, ego, SECONDS + 2, step_us)
    for uid in models:
        assert np.isfinite(result.column(uid, "speed_m_s")).all() and (result.column(uid, "speed_m_s") >= 0).all()
        over = jumps(result, uid)
        assert len(over) == 0 or over.max() < WINDOW_M * step_us / 100_000 + 0.02, (uid, models[uid].type, over.max())
        headings = np.unwrap([state.heading_rad for state in result.states(uid)])
        assert np.abs(np.diff(headings)).max() < 0.2 * 15 * step_us / 1e6 + 0.1, (uid, models[uid].type)


HAIRPIN = np.array([[0.0, 0], [30, 0], [33, 2], [30, 4], [0, 4]])


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_place_is_that_of_many_samples(seed: int) -> None:
    rng = np.random.default_rng([28, seed])
    points = np.cumsum(rng.normal(0, 3, (12, 2)), 0)
    first, last = rng.uniform(-4, 4, 2)
    before, after = (np.array([math.cos(angle), math.sin(angle)]) for angle in (first, last))
    line = Polyline.through(points, before, after)
    at = np.linspace(-80, line.length_m + 80, 40_001)
    samples = np.stack([np.interp(at, line.along_m, points[:, axis]) for axis in (0, 1)], -1)
    samples += np.minimum(at, 0)[:, None] * before + np.maximum(at - line.length_m, 0)[:, None] * after
    for x, y in rng.uniform(-20, 20, (40, 2)).tolist():
        away = np.hypot(samples[:, 0] - x, samples[:, 1] - y)
        found = line.project(x, y)
        assert found.away_m == pytest.approx(away.min(), abs=0.01)
        place = samples[np.argmin(np.abs(at - found.along_m))]
        assert np.hypot(*(place - [x, y])) == pytest.approx(found.away_m, abs=0.01)
        assert abs(found.left_m) <= found.away_m + 1e-9
        assert line.project(x, y, found.along_m) == found


def test_of_two_parts_the_one_near_is_taken() -> None:
    line = Polyline.through(HAIRPIN)
    assert line.project(10, 2.5).along_m > 30
    assert line.project(10, 2.5, 9.0)[:3] == pytest.approx((10, 2.5, 2.5))
    assert line.project(10, 2.5, line.length_m)[:3] == pytest.approx((line.length_m - 10, 1.5, 1.5))


def test_ends_that_do_not_go_on() -> None:
    line = Polyline.through(np.array([[0.0, 0], [10, 0]]))
    assert line.project(-3, 4)[:3] == pytest.approx((0, 4, 5))
    assert line.project(13, -4)[:3] == pytest.approx((10, -4, 5))
    assert Polyline.through(np.array([[1.0, 1]])).project(4, 5)[:3] == pytest.approx((0, 0, 5))


def test_points_that_are_spaced() -> None:
    points = np.array([[0.0, 0], [0.3, 0], [0.6, 0], [0.9, 0], [1.2, 0]])
    assert spaced(points, 0.5).tolist() == [0, 2, 4]
    assert spaced(points[:1], 0.5).tolist() == [0]
