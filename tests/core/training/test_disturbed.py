"""Disturbed boxes, and how much of a disturbance is taken back, on cases worked by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_log import small_drive, write_small_log

from unisim_blender.core.cli.main import run
from unisim_blender.core.evaluation.tracklets import offset_errors, taken_back
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.training.poses import disturbed
from unisim_blender.core.world.drive import Actor

KEYS = 4


def poses(x: list[float], yaw_deg: list[float]) -> FloatArray:
    """Poses at (x, 0, 0), turned about z."""
    positions = np.stack([np.array(x), np.zeros(len(x)), np.zeros(len(x))], -1)
    return make_pose(positions, quaternion_from_yaw(np.radians(yaw_deg)))


def on(path: FloatArray, moving: bool = True) -> Actor:
    trajectory = Trajectory.from_poses(0.1 * np.arange(len(path)), path)
    return replace(small_drive().actors["car-1"], world_from_actor=trajectory, is_moving=moving)


def test_a_constant_offset_in_the_box_is_no_error() -> None:
    true = poses([0, 1, 2, 3], [0, 30, 60, 90])
    offset = make_pose(np.array([0.3, -0.2, 0.1]), quaternion_from_yaw(0.2))
    shift_m, turn_rad = offset_errors(true, true @ offset)
    np.testing.assert_allclose(shift_m, 0, atol=1e-12)
    np.testing.assert_allclose(turn_rad, 0, atol=1e-7)
    # in the world's axes the same shift is none that an appearance in the box could make up for
    shift_m, _ = offset_errors(true, make_pose(np.array([0.3, 0.0, 0.0]), np.array([1.0, 0, 0, 0])) @ true)
    mean = 0.3 * np.mean([[np.cos(a), -np.sin(a)] for a in np.radians([0, 30, 60, 90])], 0)
    np.testing.assert_allclose(shift_m[0], np.hypot(0.3 - mean[0], mean[1]), atol=1e-12)


def test_errors_are_what_the_mean_leaves() -> None:
    """Shifts of 0, 0.4, 0, 0.4 m are 0.2 m about their mean; turns of 3, -3, 3, -3 degrees are 3 about theirs."""
    true = poses([0, 5, 10, 15], [0, 0, 0, 0])
    shift_m, turn_rad = offset_errors(true, poses([0, 5.4, 10, 15.4], [3, -3, 3, -3]))
    np.testing.assert_allclose(shift_m, 0.2, atol=1e-12)
    np.testing.assert_allclose(np.degrees(turn_rad), 3, atol=1e-9)


def test_what_is_taken_back() -> None:
    """From 0.2 m and 3 degrees to 0.05 m and 0.6: three quarters and four fifths."""
    true = on(poses([0, 5, 10, 15], [0, 0, 0, 0]))
    before = on(poses([0, 5.4, 10, 15.4], [3, -3, 3, -3]))
    after = on(poses([1, 6.1, 11, 16.1], [0.6, -0.6, 0.6, -0.6]))
    still = replace(true, is_moving=False)
    found = taken_back({"a": true, "b": still}, {"a": before, "b": still}, {"a": after, "b": still})
    assert found is not None and found["actors"] == 1
    expected = {
        "disturbed_m": 0.2, "refined_m": 0.05, "shift_taken_back": 0.75,
        "disturbed_deg": 3.0, "refined_deg": 0.6, "turn_taken_back": 0.8,
    }  # fmt: skip
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=1e-7), name
    same = taken_back({"a": true}, {"a": before}, {"a": before})
    assert same is not None and same["shift_taken_back"] == 0.0 and same["turn_taken_back"] == 0.0
    assert taken_back({"b": still}, {"b": still}, {"b": still}) is None


def test_noise_is_each_frames_own_and_known() -> None:
    drive = small_drive()
    path = Trajectory(np.arange(4000.0), np.zeros((4000, 3)), np.tile([1.0, 0, 0, 0], (4000, 1)))
    long = replace(drive, actors={**drive.actors, "car-1": replace(drive.actors["car-1"], world_from_actor=path)})
    noisy = disturbed(long, 0.3, 3.0, 7)
    moved = noisy.actors["car-1"].world_from_actor
    shift, yaw = moved.positions, np.degrees(2 * np.arctan2(moved.quaternions_wxyz[:, 3], moved.quaternions_wxyz[:, 0]))
    np.testing.assert_allclose(shift[:, :2].std(0), 0.3, rtol=0.04)
    assert not shift[:, 2].any() and abs(np.corrcoef(shift[1:, 0], shift[:-1, 0])[0, 1]) < 0.05
    np.testing.assert_allclose(yaw.std(), 3.0, rtol=0.04)
    np.testing.assert_array_equal(
        disturbed(long, 0.3, 3.0, 7).actors["car-1"].world_from_actor.positions, moved.positions
    )
    assert not np.array_equal(disturbed(long, 0.3, 3.0, 8).actors["car-1"].world_from_actor.positions, moved.positions)
    for uid in ("van", "cone"):
        assert noisy.actors[uid] is long.actors[uid], "what stands still is left alone"
    assert list(noisy.actors) == list(long.actors)


def test_training_on_disturbed_boxes_tells_of_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, scene = tmp_path / "log", tmp_path / "scene"
    write_small_log(log)
    options = ["--preset", "tiny", "--iterations", "1", "--frames", "0:2", "--quiet", "--disturb", "0.3", "3"]
    assert run(["train", str(log), "--out", str(scene), *options]) == 0
    said = capsys.readouterr().out
    assert "boxes of 1 moving actors were off by 0." in said and "0 % and 0 % taken back" in said.replace("-0", "0")
    training = json.loads((scene / "scene.json").read_text())["training"]
    assert training["disturbed"] == {"metres": 0.3, "degrees": 3.0}
    assert run(["eval", str(scene), str(log), "--out", str(tmp_path / "eval"), "--frames", "3"]) == 0
    metrics = json.loads((tmp_path / "eval/metrics.json").read_text())["tracklets"]
    assert metrics["actors"] == 1 and 0.05 < metrics["disturbed_m"] < 0.8
    assert metrics["refined_m"] == pytest.approx(metrics["disturbed_m"], abs=1e-3)
