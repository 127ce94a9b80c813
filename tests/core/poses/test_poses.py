"""The ego's trajectory refined by sweeps of a street of boxes, whose true poses are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unisim_blender.core.data.log import REFINED, Log, Sweep, extras_of
from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    invert_pose,
    make_pose,
    nearest_rotation,
    quaternion_from_yaw,
)
from unisim_blender.core.poses import refine
from unisim_blender.core.poses.posed import measured, posed_log
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.world.drive import Actor, Appearance, Drive, Lidar, LidarModel

MODEL = LidarModel(np.radians(np.linspace(8, -20, 24)), np.zeros(24), columns=240, max_range_m=60.0)
FRAMES = 12
MOUNT = make_pose(np.array([0.5, 0.0, 1.8]), np.array([1.0, 0, 0, 0]))


@pytest.fixture(autouse=True)
def few_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(refine, "POINTS", 500)


def boxes() -> FloatArray:
    """Corners (K, 2, 3) of what stands beside the road."""
    rng = np.random.default_rng(3)
    rows = []
    for x in np.arange(-40.0, 60.0, 7.0):
        for side in (-1.0, 1.0):
            near = side * rng.uniform(5, 9)
            size = rng.uniform([1.5, 1.0, 1.5], [5.0, 3.0, 6.0])
            low = np.array([x + rng.uniform(-2, 2), min(near, near + side * size[1]), 0.0])
            rows.append([low, low + size])
    return np.array(rows)


STANDING = boxes()


def ranges(origins: FloatArray, directions: FloatArray, solid: FloatArray) -> FloatArray:
    """Distances (N,) to the ground or a box; inf beyond the LiDAR's range."""
    with np.errstate(divide="ignore"):
        ground = np.where(directions[:, 2] < 0, -origins[:, 2] / directions[:, 2], np.inf)
        ends = (solid[None] - origins[:, None, None]) / directions[:, None, None]
    enter, leave = ends.min(2).max(-1), ends.max(2).min(-1)
    met = np.where((enter > 0) & (enter < leave), enter, np.inf).min(1)
    nearest = np.minimum(ground, met)
    return np.where(nearest < MODEL.max_range_m, nearest, np.inf)


def true_ego(time_s: FloatArray) -> FloatArray:
    """A bend, in which the ego gains speed: poses (..., 4, 4)."""
    yaw = 0.12 * time_s**2
    x, y = 7 * time_s + time_s**2, 0.28 * time_s**3
    return make_pose(np.stack([x, y, np.zeros_like(x)], -1), quaternion_from_yaw(yaw))


class StreetLog:
    """A log of the street, whose ego is where ``world_from_ego`` says, not where it truly is."""

    def __init__(self, path: Path, world_from_ego: Trajectory, frames: int = FRAMES, speed: float = 1.0) -> None:
        self.path, self.missing = path, ()
        if not path.exists():
            path.touch()
        times = {frame: frame * 0.1 for frame in range(frames)}
        lidar = Lidar("top", MODEL, world_from_ego.transformed(right=MOUNT), times)
        keys = np.arange(-2, frames + 2) * 0.1
        self.truth = Trajectory.from_poses(keys, true_ego(speed * keys))
        size, ahead = np.array([4.0, 2.0, 1.6]), make_pose(np.array([9.0, 0, 0.8]), np.array([1.0, 0, 0, 0]))
        self.true_car = self.truth.transformed(right=ahead)
        boxes = world_from_ego.transformed(right=ahead)  # as labels are: relative to the vehicle
        car = Actor("car", "Car", size, boxes, -np.inf, np.inf, True, Appearance("car"))
        self.drive = Drive("street", tuple(times), times, world_from_ego, {}, {"top": lidar}, {"car": car})

    def image_frames(self, camera: str) -> tuple[int, ...]:
        return ()

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        return self.drive.frames

    def sweep(self, lidar: str, frame: int) -> Sweep:
        sensor = self.drive.lidars["top"]
        there = replace(sensor, world_from_lidar=self.truth.transformed(right=MOUNT))
        rays = lidar_rays(there, sensor.time_s[frame]).flat()
        car, half = self.true_car.at(sensor.time_s[frame] - 0.05)[:3, 3], self.drive.actors["car"].size_m * 0.45
        solid = np.concatenate([STANDING, [[car - half, car + half]]])
        depth = ranges(rays.origins, rays.directions, solid)
        met = np.flatnonzero(np.isfinite(depth))
        depth = depth[met] + np.random.default_rng(frame).normal(0, 0.01, len(met))
        points, times = rays.origins[met] + rays.directions[met] * depth[:, None], rays.time_s[met]
        seen = sensor.world_from_lidar.at(times) @ invert_pose(there.world_from_lidar.at(times))
        none = np.full(len(met), -1, np.int32)
        return Sweep(
            np.einsum("nij,nj->ni", seen[:, :3, :3], points) + seen[:, :3, 3],
            sensor.world_from_lidar.at(times)[:, :3, 3], times, np.ones(len(met), np.float32), none, none, none,
        )  # fmt: skip


def white(time_s: FloatArray) -> FloatArray:
    rng = np.random.default_rng(1)
    shift, turn = rng.normal(0, 0.1, (len(time_s), 3)), rng.normal(0, np.radians(0.3), len(time_s))
    return np.asarray(true_ego(time_s) @ make_pose(shift, quaternion_from_yaw(turn)))


def drifting(time_s: FloatArray) -> FloatArray:
    away = np.stack([0.1 * time_s, 0.3 * time_s, 0.1 * time_s], -1)
    return np.asarray(make_pose(away, quaternion_from_yaw(np.radians(1.0) * time_s)) @ true_ego(time_s))


def nodding(time_s: FloatArray) -> FloatArray:
    """Pitch of a quarter of a degree, up and down: returns lie as near to others as before."""
    pitch = np.radians(0.25) * np.sin(2 * np.pi * time_s / 1.6)
    quaternion = np.stack([np.cos(pitch / 2), 0 * pitch, np.sin(pitch / 2), 0 * pitch], -1)
    return np.asarray(true_ego(time_s) @ make_pose(np.zeros((len(pitch), 3)), quaternion))


def turned(time_s: FloatArray) -> FloatArray:
    return np.asarray(true_ego(time_s) @ make_pose(np.zeros(3), quaternion_from_yaw(np.radians(2.0))))


def late(time_s: FloatArray) -> FloatArray:
    return true_ego(time_s - 0.05)


def street(path: Path, poses: Callable[[FloatArray], FloatArray], **options: Any) -> Log:
    keys = np.arange(-1, options.get("frames", FRAMES) + 1) * 0.1
    log: Any = StreetLog(path / "log", Trajectory.from_poses(keys, poses(keys)), **options)
    return log


def errors(track: Trajectory, truth: Trajectory, times: FloatArray) -> tuple[float, float]:
    """Largest distance, metres, and angle, degrees, from truth, in the world that fits best."""
    here, there = track.at(times), truth.at(times)
    turn = nearest_rotation((there[:, :3, :3] @ here[:, :3, :3].swapaxes(1, 2)).mean(0))
    apart = here[:, :3, 3] @ turn.T - there[:, :3, 3]
    left = there[:, :3, :3].swapaxes(1, 2) @ turn @ here[:, :3, :3]
    angle = np.arccos(np.clip((np.trace(left, axis1=1, axis2=2) - 1) / 2, -1, 1))
    return float(np.linalg.norm(apart - apart.mean(0), axis=1).max()), float(np.degrees(angle.max()))


@pytest.mark.parametrize("disturbed", [white, drifting, turned, late])
def test_disturbed_poses_are_taken_back(disturbed: Any, tmp_path: Path) -> None:
    log: Any = street(tmp_path, disturbed)
    chosen = posed_log(log, "refined")
    assert extras_of(chosen.log).poses == REFINED, chosen.sentences
    times = np.array(list(log.drive.time_s.values()))
    track, truth = (t.transformed(right=MOUNT) for t in (chosen.log.drive.world_from_ego, log.truth))
    away_m, away_deg = errors(track, truth, times - 0.05)
    assert away_m < 0.03 and away_deg < 0.1
    before, after = measured(log), measured(chosen.log)
    assert all(new.apart_m <= old.apart_m + 0.01 for new, old in zip(after.lags, before.lags, strict=True))


def test_a_bias_of_the_heading_is_said(tmp_path: Path) -> None:
    log: Any = street(tmp_path, turned)
    chosen = posed_log(log, "refined")
    (sentence,) = (sentence for sentence in chosen.sentences if "heading is turned" in sentence)
    bias = float(sentence.split("turned by ")[1].split(" ")[0])
    assert bias == pytest.approx(2.0, abs=0.1)
    assert not any(
        "heading is turned" in sentence for sentence in posed_log(street(tmp_path, white), "refined").sentences
    )


def test_poses_that_fit_stay_and_what_drifts_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = street(tmp_path, true_ego)
    assert posed_log(log, "auto").log is log and not measured(log).doubt
    drifted = street(tmp_path, drifting)
    with monkeypatch.context() as unread:
        unread.setattr(StreetLog, "sweep", None)
        assert measured(log).lags, "what was measured is cached"
        with pytest.raises(TypeError):  # and other poses of the same files are measured anew
            measured(drifted)
    doubt = measured(drifted).doubt
    assert "poses drift" in doubt and "top" in doubt
    kept = posed_log(drifted, "log")
    assert kept.log is drifted and any("--poses refined" in sentence for sentence in kept.sentences)


def test_an_error_of_pitch_shows_in_the_distance_to_planes_alone(tmp_path: Path) -> None:
    log: Any = street(tmp_path, nodding)
    report = measured(log)
    assert "poses drift" in report.doubt
    assert all(row.apart_m < row.plausible_m + 0.01 for row in report.lags)
    chosen = posed_log(log, "auto")
    assert chosen.log is not log
    times = np.array(list(log.drive.time_s.values()))
    track, truth = (t.transformed(right=MOUNT) for t in (chosen.log.drive.world_from_ego, log.truth))
    assert errors(track, truth, times - 0.05)[1] < 0.5 * errors(log.drive.world_from_ego, log.truth, times - 0.05)[1]


def test_boxes_and_sweeps_move_with_the_ego(tmp_path: Path) -> None:
    log = street(tmp_path, drifting)
    refined = posed_log(log, "auto").log
    assert refined is not log
    before, after = log.sweep("top", 5), refined.sweep("top", 5)
    np.testing.assert_allclose(
        np.linalg.norm(after.points - after.origins, axis=1), np.linalg.norm(before.points - before.origins, axis=1)
    )
    for drive_log in (log, refined):
        drive = drive_log.drive
        keys = drive.actors["car"].world_from_actor.times_s
        ahead = invert_pose(drive.world_from_ego.at(keys)) @ drive.actors["car"].world_from_actor.at(keys)
        np.testing.assert_allclose(ahead[:, :3, 3], np.tile([9.0, 0, 0.8], (len(keys), 1)), atol=1e-6)
        sweep, lidar = drive_log.sweep("top", 5), drive.lidars["top"].world_from_lidar
        np.testing.assert_allclose(sweep.origins, lidar.at(sweep.time_s)[:, :3, 3], atol=2e-3)


def test_sweeps_that_tell_nothing_leave_the_poses_alone(tmp_path: Path) -> None:
    one = street(tmp_path, drifting, frames=1)
    assert posed_log(one, "auto").log is one
    with pytest.raises(LogError, match="has no two sweeps"):
        posed_log(one, "refined")
    still = street(tmp_path, lambda times: true_ego(0 * times), frames=4, speed=0.0)
    assert posed_log(still, "auto").log is still
    track = posed_log(still, "refined").log.drive.world_from_ego
    np.testing.assert_allclose(track.positions, 0, atol=0.01)
    apart = street(tmp_path, lambda times: true_ego(60 * times), frames=4, speed=60.0)  # no two sweeps share anything
    assert posed_log(apart, "auto").log is apart
    times = np.arange(4) * 0.1
    np.testing.assert_allclose(
        posed_log(apart, "refined").log.drive.world_from_ego.at(times), apart.drive.world_from_ego.at(times), atol=0.05
    )
