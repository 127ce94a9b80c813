"""Boxes followed through sweeps that are computed here: a box passes, another stands, on level ground."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from unisim_blender.core.data.log import Sweep
from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    intersect_boxes,
    invert_pose,
    make_pose,
    quaternion_from_yaw,
)
from unisim_blender.core.tracks import follow as follow_module
from unisim_blender.core.tracks import scans
from unisim_blender.core.tracks.box_file import Track
from unisim_blender.core.tracks.doubtful import doubtful_places
from unisim_blender.core.tracks.follow import DrawnBox
from unisim_blender.core.tracks.scans import SweepStore
from unisim_blender.core.world.drive import Actor, Appearance

SIZE = np.array([4.5, 1.9, 1.6])
SWEEPS, SWEEP_S = 24, 0.1


def car_at(time_s: float) -> FloatArray:
    """A car on a bend, which drives 12 m/s."""
    heading = 0.12 * time_s
    place = [-8 + 12 * time_s, 7 + 0.72 * time_s**2, SIZE[2] / 2]
    return make_pose(np.array(place), quaternion_from_yaw(heading))


def follow(store: SweepStore, track: Track, drawn: list[DrawnBox], refine: bool = False, shares: Any = None) -> Track:
    """The track that following a box ends with."""
    steps = follow_module.follow(store, track, drawn, refine)
    try:
        while True:
            share = next(steps)
            if shares is not None:
                shares.append(share)
    except StopIteration as end:
        followed: Track = end.value
        return followed


PARKED = make_pose(np.array([9.0, -4.0, SIZE[2] / 2]), quaternion_from_yaw(0.3))


class Passing:
    """A log of one LiDAR that turns once in 0.1 s, on a vehicle that drives 5 m/s."""

    path = Path("passing")
    drive: Any = SimpleNamespace(lidars={"top": SimpleNamespace(time_s={n: SWEEP_S * n for n in range(SWEEPS)})})

    def __init__(self) -> None:
        self.reads = 0

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        return tuple(range(SWEEPS))

    def sweep(self, lidar: str, frame: int) -> Sweep:
        self.reads += 1
        azimuth = np.repeat(np.linspace(0, 2 * math.pi, 720, endpoint=False), 24)
        up = np.tile(np.radians(np.linspace(-22, 2, 24)), 720)
        time_s = SWEEP_S * (frame + azimuth / (2 * math.pi) - 0.5)
        rays = np.stack([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)], -1)
        origins = np.stack([5 * time_s, 0 * time_s, 0 * time_s + 1.8], -1)
        with np.errstate(divide="ignore"):
            depth = np.where(rays[:, 2] < 0, -1.8 / rays[:, 2], np.inf)
        # the car where it is when each column looks
        for column in range(720):
            rows = slice(24 * column, 24 * column + 24)
            places = np.stack([invert_pose(car_at(time_s[rows.start])), invert_pose(PARKED)])
            enter, leave = intersect_boxes(origins[rows], rays[rows], places, np.stack([SIZE, SIZE]))
            met = (enter <= leave) & (leave > 0)
            near = np.where(met, enter, np.inf).min(1)
            depth[rows] = np.minimum(depth[rows], near)
        there = depth < 60
        count = int(there.sum())
        points = (origins + rays * np.where(there, depth, 0)[:, None])[there]
        rng = np.random.default_rng(frame)
        points += 0.01 * rng.standard_normal(points.shape)
        none = np.full(count, -1, np.int32)
        return Sweep(points, origins[there], time_s[there], np.ones(count, np.float32), none, none, none)


@pytest.fixture(scope="module")
def store() -> SweepStore:
    log: Any = Passing()
    return SweepStore(log)


def passed_s(frame: int) -> float:
    """When the beams of a sweep pass the car."""
    time_s = SWEEP_S * frame
    for _ in range(8):
        at = car_at(time_s)[:2, 3] - [5 * time_s, 0]
        time_s = SWEEP_S * (frame + math.atan2(at[1], at[0]) % (2 * math.pi) / (2 * math.pi) - 0.5)
    return time_s


def off(pose: FloatArray, truth: FloatArray) -> tuple[float, float]:
    """Distance of two poses, metres, and angle between their headings, degrees."""
    apart = invert_pose(truth) @ pose
    return float(np.linalg.norm(apart[:2, 3])), abs(math.degrees(math.atan2(apart[1, 0], apart[0, 0])))


def disturbed(pose: FloatArray, x: float, y: float, degrees: float) -> FloatArray:
    return pose @ make_pose(np.array([x, y, 0.0]), quaternion_from_yaw(math.radians(degrees)))


def errors(track: Track) -> FloatArray:
    path = track.actor.world_from_actor
    return np.array([off(pose, car_at(time)) for time, pose in zip(path.times_s, path.poses, strict=True)])


def box(size: FloatArray = SIZE) -> Track:
    """A track of nothing but a size."""
    nowhere = Trajectory.from_poses(np.zeros(1), np.eye(4)[None])
    return Track(Actor("box", "Car", size, nowhere, -np.inf, np.inf, False, Appearance("box")), source="person")


def test_a_moving_car_is_followed_both_ways_from_one_box(store: SweepStore) -> None:
    time_s = passed_s(9)
    shares: list[float] = []
    result = follow(store, box(), [DrawnBox(time_s, car_at(time_s))], shares=shares)
    path = result.actor.world_from_actor
    assert result.actor.is_moving and path.times_s[0] < 0.05 and path.times_s[-1] > 2.2
    centre, heading = errors(result).T
    assert np.median(centre) < 0.15 and centre.max() < 0.4 and np.median(heading) < 0.5
    assert result.certainty == 1.0 and result.returns > 500 and result.unsure == ()
    assert shares == sorted(shares) and shares[-1] == 1.0 and len(shares) > 20
    assert len(path.times_s) >= 22 and result.drawn_s == (time_s,)
    again = follow(store, box(), [DrawnBox(time_s, car_at(time_s))])
    assert (again.actor.world_from_actor.poses == path.poses).all()


def test_a_box_that_is_off_is_refined(store: SweepStore) -> None:
    time_s = passed_s(9)
    drawn = [DrawnBox(time_s, disturbed(car_at(time_s), 0.15, -0.12, 5.0))]
    plain, refined = (follow(store, box(SIZE + [0.3, 0, 0]), drawn, refine) for refine in (False, True))
    assert np.median(errors(plain)[:, 1]) > 3.0
    assert off(plain.actor.world_from_actor.at(time_s), drawn[0].pose)[0] < 1e-9
    centre, heading = np.median(errors(refined), 0)
    assert centre < 0.12 and heading < 1.0 and abs(refined.actor.size_m - SIZE).max() < 0.15


def test_a_parked_car_stands(store: SweepStore) -> None:
    drawn = [DrawnBox(0.7, disturbed(PARKED, 0.1, 0.1, -4.0))]
    result = follow(store, box(), drawn)
    path = result.actor.world_from_actor
    assert not result.actor.is_moving and len(path.times_s) == 1 and result.sweeps > 20
    assert result.actor.start_s < 0.1 and result.actor.end_s > 2.2
    assert off(path.poses[0], drawn[0].pose)[0] < 1e-9
    centre, heading = off(follow(store, box(), drawn, refine=True).actor.world_from_actor.poses[0], PARKED)
    assert centre < 0.08 and heading < 1.0


def test_a_correction_is_met_and_changes_the_spans_beside_it_alone(store: SweepStore) -> None:
    first, second, third = (DrawnBox(passed_s(n), car_at(passed_s(n))) for n in (3, 11, 19))
    before = follow(store, box(), [first, third])
    moved = DrawnBox(second.time_s, disturbed(second.pose, 0.0, 0.3, 0.0))
    after = follow(store, before, [first, moved, third])
    old, new = before.actor.world_from_actor, after.actor.world_from_actor
    assert off(new.at(moved.time_s), moved.pose)[0] < 1e-6
    outside = (old.times_s < first.time_s) | (old.times_s > third.time_s)
    assert outside.sum() > 4 and np.isin(old.times_s[outside], new.times_s).all()
    assert np.allclose(new.at(old.times_s[outside]), old.poses[outside], atol=1e-9)
    centre = errors(after)[:, 0]
    ends = [int(np.abs(new.times_s - box.time_s).argmin()) for box in (first, third)]
    assert centre[ends].max() < 1e-6 and 0.05 < centre[ends[0] : ends[1]].mean() < 0.4


def test_sweeps_that_do_not_fit_into_memory_are_read_again(store: SweepStore, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = [DrawnBox(0.7, PARKED)]
    whole = follow(store, box(), drawn)
    log: Any = Passing()
    small = SweepStore(log)
    most = 3 * store.near(0, np.zeros(2), 1e3).nbytes
    monkeypatch.setattr(scans, "STORED_BYTES", most)
    again = follow(small, box(), drawn)
    assert (again.returns, again.sweeps, again.actor.end_s) == (whole.returns, whole.sweeps, whole.actor.end_s)
    assert small._bytes <= most and log.reads > SWEEPS


def test_what_is_not_there_is_not_followed(store: SweepStore) -> None:
    nothing = make_pose(np.array([-20.0, -20.0, 0.8]), quaternion_from_yaw(0.0))
    result = follow(store, box(), [DrawnBox(1.0, nothing)])
    assert not result.actor.is_moving and result.sweeps == 0
    with pytest.raises(LogError, match="drawn before"):
        follow(store, box(), [])


def track(uid: str, places: FloatArray, times: FloatArray, yaw: Any = 0.0, size: Any = SIZE) -> Track:
    turns = quaternion_from_yaw(np.broadcast_to(np.asarray(yaw, float), times.shape))
    path = Trajectory(times, places, turns)
    return Track(Actor(uid, "Car", np.asarray(size), path, times[0], times[-1], len(times) > 1, Appearance(uid)))


def test_doubtful_places() -> None:
    times = 0.1 * np.arange(21)
    along = np.stack([12 * times, 0 * times, 0 * times], -1)
    assert doubtful_places([track("good", along, times)], times) == ()
    jumps = along.copy()
    jumps[10:, 1] += 1.5
    spins = np.where(times > 1.0, 0.6, 0.0)
    there = [*range(8), *range(13, 21)]
    tracks = [
        track("jump", jumps + [0, 20, 0], times),
        track("gap", along[there] + [0, 40, 0], times[there]),
        track("fast", 5 * along + [0, 60, 0], times),
        track("turn", along + [0, 80, 0], times, spins),
        track("aside", along + [0, 100, 0], times, 1.0),
        track("size", along[:1] + [0, 120, 0], times[:1], size=[4.5, 6.0, 1.6]),
        track("twin", along + [1.0, 80, 0], times),
    ]
    places = doubtful_places(tracks, times)
    by_uid = {
        uid: [place for place in places if place.uid == uid] for uid in "jump gap fast turn aside size twin".split()
    }
    kinds = {uid: {place.kind for place in found} for uid, found in by_uid.items()}
    assert "jump" in kinds["jump"] and kinds["gap"] == {"gap"} and kinds["fast"] == {"speed"}
    assert "turn" in kinds["turn"] and "overlap" in kinds["turn"] and kinds["aside"] == {"sideways"}
    assert kinds["size"] == {"size"} and kinds["twin"] == set()
    assert abs(next(p.time_s for p in by_uid["jump"] if p.kind == "jump") - 0.95) < 0.11
    (overlap,) = (place for place in by_uid["turn"] if place.kind == "overlap")
    assert overlap.other == "twin" and 0.5 < overlap.value <= 1.0
    unsure = replace(track("good", along, times), unsure=((1.6, 0.1),))
    assert [(place.kind, place.time_s) for place in doubtful_places([unsure], times)] == [("uncertain", 1.6)]
    seen = replace(tracks[0], dismissed=((1.2, "jump"),))
    assert "jump" not in {place.kind for place in doubtful_places([seen, *tracks[1:]], times) if place.uid == "jump"}
    assert doubtful_places([replace(unsure, dismissed=((1.6, "jump"), (9.0, "uncertain")))], times) != ()
