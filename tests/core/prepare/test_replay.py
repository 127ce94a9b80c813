"""A scene knows its log in a copy, a part and another layout, and no other drive; frames that its log lacked are replayed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from written_street import write_recipe

from unisim_blender.core.cli.main import run, unisim
from unisim_blender.core.data.fingerprint import Fingerprint, compare_log, fingerprint_of
from unisim_blender.core.data.log import Log
from unisim_blender.core.data.moved import MovedLog, moved_log
from unisim_blender.core.errors import SceneError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import Trajectory, make_pose, quaternion_from_yaw, transform_points
from unisim_blender.core.json_file import Node
from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.prepare.replay import aligned_log, replayed_drive

KITTI = "2000_01_01/2000_01_01_drive_0001_sync"
TRAIN = ["--preset", "tiny", "--rays", "512", "--iterations", "3", "--width", "64", "--quiet"]


def command(*arguments: object) -> str:
    result = CliRunner().invoke(unisim, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A street of four frames in three layouts, another street driven alike, and scenes trained on both of the first."""
    folder = tmp_path_factory.mktemp("drives")
    for seed, name in ((0, "log"), (1, "other")):
        write_recipe(folder / name, frames=4, width=64, seed=seed)
        shutil.rmtree(folder / name / "annotations" / "cuboids")
    for layout in ("kitti", "ncore", "nuscenes"):
        command("convert", folder / "log", "--to", layout, "--out", folder / layout, "--quiet")
    command("train", folder / "log", "--out", folder / "scene", *TRAIN)
    return folder


def without(folder: Path, frames: tuple[int, ...]) -> None:
    """Remove the images and sweeps of frames from a log in KITTI's layout."""
    for frame in frames:
        for path in folder.rglob(f"{frame:010d}.*"):
            if "oxts" not in path.parts:
                path.unlink()


@pytest.mark.parametrize("layout", ["log", "ncore", "nuscenes", f"kitti/{KITTI}"])
def test_a_scene_knows_its_drive_in_every_layout(layout: str, made: Path) -> None:
    header, log = read_scene_header(made / "scene"), open_log(made / layout)
    assert header.fingerprint is not None
    found = compare_log(header.fingerprint, log)
    assert found.difference == ""
    assert "the ego's motion over 4 frames" in found.compared and "sweeps of pandar64" in found.compared
    assert "images of front_camera" in found.compared
    assert aligned_log(header, log) is log, "each layout's world begins at the first pose of the ego"


def test_a_copy_with_other_times_of_files_is_the_same_drive(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "log", tmp_path / "copy", copy_function=shutil.copy)
    command("eval", made / "scene", tmp_path / "copy", "--frames", 1, "--out", tmp_path / "e")


@pytest.mark.parametrize("frames", [(0,), (0, 1), (3,), (2, 3), (1, 2)])
def test_a_part_is_the_same_drive(frames: tuple[int, ...], made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "kitti", tmp_path / "part")
    without(tmp_path / "part", frames)
    header = read_scene_header(made / "scene")
    log = aligned_log(header, open_log(tmp_path / "part" / KITTI))
    drive = replayed_drive(header, log)
    for frame in drive.frames:
        time = drive.time_s[frame]
        np.testing.assert_allclose(drive.world_from_ego.at(time), header.drive.world_from_ego.at(time), atol=0.02)


@pytest.mark.parametrize("edit", ["drive", "sweeps", "images", "motion"])
def test_another_drive_is_refused_and_what_differs_is_said(edit: str, made: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    shutil.copytree(made / ("other" if edit == "drive" else "log"), log)
    if edit in ("sweeps", "images"):
        part = {"sweeps": "lidar", "images": "camera/front_camera"}[edit]
        for path in (made / "other" / part).glob("[0-9]*"):
            shutil.copy(path, log / part / path.name)
    if edit == "motion":
        for file in log.rglob("poses.json"):
            poses = json.loads(file.read_text())
            poses[3]["position"]["x"] += 3.0
            file.write_text(json.dumps(poses))
    with pytest.raises(SceneError, match="was trained on another drive than") as error:
        aligned_log(read_scene_header(made / "scene"), open_log(log))
    said = {"drive": "sweeps agree in", "sweeps": "sweeps agree in", "images": "of 255", "motion": "m away at frame 3"}
    assert said[edit] in str(error.value) and "compared: the ego's motion over 4 frames" in str(error.value)


def scenario(made: Path, folder: Path, log: str) -> Path:
    path = folder / "scenario.json"
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": str(made / log), "edits": []}
    path.write_text(json.dumps({**document, "scene": str(made / "scene")}))
    return path


@pytest.mark.parametrize("name", ["eval", "render", "drive", "train"])
def test_commands_refuse_a_scene_of_another_drive(
    name: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, other = tmp_path / "out", made / "other"
    if name == "train":
        shutil.copytree(made / "scene", out)
    arguments = {
        "eval": [made / "scene", other, "--frames", 1, "--out", out],
        "render": [scenario(made, tmp_path, "other"), "--out", out],
        "drive": [scenario(made, tmp_path, "other"), "--driver", "log", "--out", out],
        "train": [other, "--out", out, "--resume", *TRAIN[:4], "--iterations", 6, "--width", 64, "--quiet"],
    }[name]
    before = {path.name: path.read_bytes() for path in out.iterdir()} if out.is_dir() else None
    assert run([name, *map(str, arguments)]) == 1
    assert "another drive than" in capsys.readouterr().err
    after = {path.name: path.read_bytes() for path in out.iterdir()} if out.is_dir() else None
    assert before == after, "nothing is lost, and nothing half written"


def test_training_goes_on_with_a_copy(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "scene", tmp_path / "scene")
    shutil.copytree(made / "log", tmp_path / "copy")
    said = command("train", tmp_path / "copy", "--out", tmp_path / "scene", "--resume", *TRAIN[:4], "--iterations", 4,
                   "--width", 64, "--quiet")  # fmt: skip
    assert "4 steps" in said


@pytest.mark.parametrize("missing", [(3,), (0,), (2, 3)])
def test_frames_that_the_scenes_log_lacked_are_evaluated(missing: tuple[int, ...], made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "kitti", tmp_path / "part")
    without(tmp_path / "part", missing)
    command("train", tmp_path / "part" / KITTI, "--out", tmp_path / "scene", *TRAIN, "--frames", ":")
    frames = str(missing[0]) if len(missing) == 1 else f"{missing[0]}:"
    command("eval", tmp_path / "scene", made / "kitti" / KITTI, "--frames", frames, "--out", tmp_path / "e")
    metrics = json.loads((tmp_path / "e" / "metrics.json").read_text())
    measured = {record["frame"]: record for record in metrics["per_frame"]}
    assert set(missing) <= set(measured)
    assert all(measured[frame]["camera"] and measured[frame]["lidar"] for frame in missing)


def shorter(log: Log, frames: tuple[int, ...]) -> Any:
    """A drive up to the last of some frames, all of its trajectories, too."""
    drive = log.drive
    end = drive.time_s[frames[-1]]

    def cut(track: Trajectory) -> Trajectory:
        keep = track.times_s <= end + 1e-6
        return Trajectory(track.times_s[keep], track.positions[keep], track.quaternions_wxyz[keep])

    cameras = {
        name: replace(one, world_from_camera=cut(one.world_from_camera), time_s={f: one.time_s[f] for f in frames})
        for name, one in drive.cameras.items()
    }
    times = {frame: drive.time_s[frame] for frame in frames}
    ego = cut(drive.world_from_ego)
    return replace(drive, frames=frames, time_s=times, world_from_ego=ego, cameras=cameras, lidars={})


def test_poses_beyond_the_scenes_log_are_the_logs_with_the_last_correction(made: Path) -> None:
    log = open_log(made / "log")
    header = read_scene_header(made / "scene")
    mount = make_pose(np.array([0.02, 0.0, 0.01]), quaternion_from_yaw(0.01))
    part = shorter(log, (0, 1))
    camera = part.cameras["front_camera"]
    corrected = replace(camera, world_from_camera=camera.world_from_camera.transformed(right=mount))
    header = replace(header, drive=replace(part, cameras={"front_camera": corrected}))
    drive = replayed_drive(header, log)
    recorded, replayed = log.drive.cameras["front_camera"], drive.cameras["front_camera"]
    assert drive.frames == (0, 1, 2, 3) and replayed.time_s == recorded.time_s
    for time in recorded.time_s.values():
        expected = recorded.world_from_camera.at(time) @ mount
        np.testing.assert_allclose(replayed.world_from_camera.at(time), expected, atol=1e-6)
        np.testing.assert_allclose(drive.world_from_ego.at(time), log.drive.world_from_ego.at(time), atol=1e-9)


def test_a_whole_log_changes_no_pose_of_the_scene(made: Path) -> None:
    header = read_scene_header(made / "scene")
    drive = replayed_drive(header, open_log(made / "log"))
    assert drive.world_from_ego is header.drive.world_from_ego
    assert drive.cameras["front_camera"] is header.drive.cameras["front_camera"]


def elsewhere(log: Log, moved: Any, later_s: float) -> Log:
    return moved_log(log, lambda times: np.broadcast_to(moved, (*np.shape(times), 4, 4)), later_s, np.zeros(3))


def test_a_world_that_is_moved_and_turned_is_taken_back(made: Path) -> None:
    """Values of a log whose world begins elsewhere and whose times begin later, in the scene's world and time."""
    log, header = open_log(made / "log"), read_scene_header(made / "scene")
    moved = make_pose(np.array([120.0, -40.0, 3.0]), quaternion_from_yaw(1.2))
    back = aligned_log(header, elsewhere(log, moved, 1.5))
    assert isinstance(back, MovedLog) and back.path == log.path
    np.testing.assert_array_equal(back.image("front_camera", 1), log.image("front_camera", 1))
    for name in ("points", "origins", "time_s"):
        np.testing.assert_allclose(
            getattr(back.sweep("pandar64", 1), name), getattr(log.sweep("pandar64", 1), name), atol=1e-6
        )
    for name in ("origins", "directions", "time_s"):
        before, after = (getattr(one.sweep_grid("pandar64", 1), name) for one in (log, back))
        np.testing.assert_allclose(after, before, atol=1e-6)
    for frame, time in log.drive.time_s.items():
        assert back.drive.time_s[frame] == pytest.approx(time, abs=1e-9)
        np.testing.assert_allclose(back.drive.world_from_ego.at(time), log.drive.world_from_ego.at(time), atol=1e-6)
    np.testing.assert_allclose(
        transform_points(moved, log.sweep("pandar64", 1).points), elsewhere(log, moved, 1.5).sweep("pandar64", 1).points
    )


@pytest.mark.parametrize(("camera", "lidar"), [("front_camera", ""), ("", "pandar64")])
def test_one_kind_of_sensor_tells_drives_apart(camera: str, lidar: str, made: Path) -> None:
    own = fingerprint_of(open_log(made / "log"), camera, lidar)
    assert compare_log(own, open_log(made / "log")).difference == ""
    assert compare_log(own, open_log(made / "other")).difference != ""


def test_a_fingerprint_survives_its_file(made: Path) -> None:
    own = fingerprint_of(open_log(made / "log"), "front_camera", "pandar64")
    document = json.loads(json.dumps(own.to_json()))
    again = Fingerprint.from_json(Node(document, "", SceneError))
    assert compare_log(again, open_log(made / "log")).difference == "" and again.to_json() == document


BREAKS: dict[str, Callable[[Any], object]] = {
    "frames": lambda log: log.update(frames=[]),
    "name of a frame": lambda log: log["frames"].update(first=log["frames"].pop("0")),
    "image": lambda log: log["frames"]["0"].update(image=[1, 2]),
    "pose": lambda log: log["frames"]["0"].update(world_from_ego=[[1.0]]),
    "span": lambda log: log.update(span_rad=[0.0]),
}


@pytest.mark.parametrize("broken", BREAKS)
def test_a_broken_fingerprint_is_one_sentence(broken: str, made: Path, tmp_path: Path) -> None:
    document = json.loads((made / "scene" / "scene.json").read_text())
    BREAKS[broken](document["log"]["fingerprint"])
    (tmp_path / "scene.json").write_text(json.dumps(document))
    with pytest.raises(SceneError, match="fingerprint"):
        read_scene_header(tmp_path)
