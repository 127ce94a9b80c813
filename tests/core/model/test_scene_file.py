"""`scene.json`: exact round trip, and refusals that name file and value."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unisim_blender.core.errors import SceneError
from unisim_blender.core.geometry import Trajectory, quaternion_from_yaw
from unisim_blender.core.json_file import Node
from unisim_blender.core.model.scene_file import HEADER_NAME, SceneHeader, read_scene_header, write_scene_header
from unisim_blender.core.world.drive import (
    Actor,
    Appearance,
    Box,
    Camera,
    CameraModel,
    Drive,
    Lidar,
    LidarModel,
    RollingShutter,
    StaticCopy,
)
from unisim_blender.core.world.drive_json import drive_to_json, read_drive


def random_trajectory(rng: np.random.Generator, keys: int) -> Trajectory:
    return Trajectory(
        np.cumsum(rng.uniform(0.05, 0.2, keys)),
        rng.normal(size=(keys, 3)) * 100,
        quaternion_from_yaw(rng.normal(size=keys)),
    )


@pytest.fixture
def drive() -> Drive:
    rng = np.random.default_rng(3)
    frames = (0, 1, 3)
    times = {frame: frame * 0.1 + 1e-17 for frame in frames}
    camera = Camera(
        "front",
        CameraModel(1920, 1080, 1970.0131, 1970.0091, 970.0, 483.3, RollingShutter(-0.03, 0.5)),
        random_trajectory(rng, 5),
        times,
    )
    table = LidarModel(np.radians([10.0, 1 / 3, -20.0]), np.radians([0.0, 0.1, 0.7]), columns=5)
    lidar = Lidar("top", table, random_trajectory(rng, 4), times, rng.random((3, 5)) < 0.5)
    actor = Actor("car-1", "Car", rng.random(3) + 1, random_trajectory(rng, 4), 0.1, 0.3, True, Appearance("car-1"))
    box = Box(random_trajectory(rng, 1).poses[0], rng.random(3))
    return Drive(
        "street",
        frames,
        times,
        random_trajectory(rng, 7),
        {"front": camera},
        {"top": lidar, "bare": replace(lidar, sensor_id="bare", blocked=None)},
        {"car-1": actor},
        (StaticCopy("copy", box, random_trajectory(rng, 1).poses[0]),),
        (box,),
        rng.normal(size=3) * 1e6,
    )


@pytest.fixture
def folder(drive: Drive, tmp_path: Path) -> Path:
    header = SceneHeader(
        tmp_path,
        "my scene",
        "street",
        "../street",
        drive.world_origin,
        {"levels": 8},
        {"size": [1.5]},
        drive,
        {"preset": "tiny"},
    )
    write_scene_header(tmp_path, header)
    return tmp_path


def test_a_header_comes_back_to_the_bit(folder: Path, drive: Drive) -> None:
    header = read_scene_header(folder)
    assert drive_to_json(header.drive) == drive_to_json(drive)
    assert (header.name, header.log_name, header.log_path) == ("my scene", "street", "../street")
    assert (header.model, header.volume, header.training) == ({"levels": 8}, {"size": [1.5]}, {"preset": "tiny"})
    np.testing.assert_array_equal(header.world_origin, drive.world_origin)
    before = (folder / HEADER_NAME).read_bytes()
    write_scene_header(folder, header)
    assert (folder / HEADER_NAME).read_bytes() == before


def test_a_scene_without_frames_is_one_sentence(folder: Path) -> None:
    document = json.loads((folder / HEADER_NAME).read_text())
    document["drive"]["frames"] = []
    (folder / HEADER_NAME).write_text(json.dumps(document))
    with pytest.raises(SceneError, match=r"scene\.json: drive\.time_s: a drive needs at least one frame$"):
        read_scene_header(folder)


def test_every_field_of_a_drive_survives(drive: Drive) -> None:
    again = read_drive(Node(json.loads(json.dumps(drive_to_json(drive))), "drive", SceneError))
    assert (again.frames, again.time_s, again.name) == (drive.frames, drive.time_s, drive.name)
    assert again.cameras["front"].model == drive.cameras["front"].model
    assert again.cameras["front"].time_s == drive.cameras["front"].time_s
    for name in ("times_s", "positions", "quaternions_wxyz"):
        for a, b in (
            (again.world_from_ego, drive.world_from_ego),
            (again.cameras["front"].world_from_camera, drive.cameras["front"].world_from_camera),
            (again.lidars["top"].world_from_lidar, drive.lidars["top"].world_from_lidar),
            (again.actors["car-1"].world_from_actor, drive.actors["car-1"].world_from_actor),
        ):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
    lidar, before = again.lidars["top"], drive.lidars["top"]
    assert lidar.blocked is not None
    assert before.blocked is not None
    np.testing.assert_array_equal(lidar.blocked, before.blocked)
    assert again.lidars["bare"].blocked is None
    assert lidar.model.elevation_rad.tobytes() == before.model.elevation_rad.tobytes()
    beams = np.zeros(3)
    bare = replace(lidar.model, elevation_rad=beams, azimuth_offset_rad=beams)
    assert bare == replace(before.model, elevation_rad=beams, azimuth_offset_rad=beams)
    actor = again.actors["car-1"]
    assert (actor.start_s, actor.end_s, actor.is_moving, actor.appearance, actor.label) == (
        0.1,
        0.3,
        True,
        Appearance("car-1"),
        "Car",
    )
    np.testing.assert_array_equal(again.static_copies[0].source.world_from_box, drive.static_removals[0].world_from_box)
    np.testing.assert_array_equal(again.world_origin, drive.world_origin)


def test_an_earlier_scene_calls_the_appearance_look(folder: Path) -> None:
    now = read_scene_header(folder)
    document = json.loads((folder / HEADER_NAME).read_text())
    actor = document["drive"]["actors"]["car-1"]
    actor["look"] = actor.pop("appearance")
    (folder / HEADER_NAME).write_text(json.dumps(document))
    assert drive_to_json(read_scene_header(folder).drive) == drive_to_json(now.drive)


def edit(folder: Path, *place: Any, value: Any = None) -> None:
    """Set the header's member at ``place``, or delete it."""
    document = json.loads((folder / HEADER_NAME).read_text())
    inner = document
    for step in place[:-1]:
        inner = inner[step]
    if value is None:
        del inner[place[-1]]
    else:
        inner[place[-1]] = value
    (folder / HEADER_NAME).write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("format",), "other", r"is no trained scene: its format is 'other'"),
        (("version",), 99, "has version 99, newer than the 1"),
        (("version",), "1", 'version: must be a whole number, not "1"'),
        (("volume",), None, 'scene.json: "volume" is missing'),
        (("training", "method"), 3, "scene.json: training.method: must be"),
        (("training", "accuracy"), {"camera": 2}, "scene.json: training.accuracy.camera: a fraction is from 0 to 1"),
        (("world_origin",), [0, 0], r"scene.json: world_origin: must be 3 numbers, not \[0, 0\]"),
        (
            ("drive", "actors", "car-1", "size_m"),
            [1, 0, 1],
            r"drive.actors.car-1.size_m: must be above 0, not \[1.0, 0.0, 1.0\]",
        ),
        (("drive", "actors", "car-1", "size_m", 1), float("nan"), r"car-1.size_m\[1\]: nan is not a finite number"),
        (("drive", "actors", "car-1", "is_moving"), 1, "is_moving: must be true or false, not 1"),
        (
            ("drive", "world_from_ego", "times_s", 1),
            0.0,
            "drive.world_from_ego: key 1 of a trajectory at 0.0 s is not later than the one before",
        ),
        (("drive", "world_from_ego", "positions"), [], "drive.world_from_ego: a trajectory needs"),
        (("drive", "time_s", 2), None, "drive.time_s: has no time of frame 3"),
        (("drive", "lidars", "top", "blocked"), "AA=", "blocked: is not base64"),
        (("drive", "lidars", "top", "blocked"), "AAAAAA==", "blocked: holds 4 bytes, not the 2 of 3 x 5 cells"),
        (("drive", "lidars", "top", "model", "direction"), 2, "direction: must be -1 or 1, not 2"),
        (("drive", "cameras", "front", "model", "fx"), -1, "cameras.front.model.fx: must be above 0, not -1.0"),
        (("drive", "cameras", "front", "model", "width"), 0, "width: must be at least 1, not 0"),
    ],
)
def test_a_bad_header_is_refused(folder: Path, place: tuple[Any, ...], value: Any, message: str) -> None:
    edit(folder, *place, value=value)
    with pytest.raises(SceneError, match=message) as caught:
        read_scene_header(folder)
    assert str(caught.value).startswith(str(folder / HEADER_NAME))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not valid JSON"),
        ("[]", "must be an object"),
        ('{"format": "unisim-scene", "version": 1e999}', "version: inf is not a finite number"),
        ("[" * 100_000, "is nested too deeply|is not valid JSON"),
        ('{"format": 1, "format": "unisim-scene"}', 'the key "format" stands twice'),
    ],
)
def test_what_is_no_header_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / HEADER_NAME).write_text(text)
    with pytest.raises(SceneError, match=message):
        read_scene_header(tmp_path)


def test_a_missing_scene_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"absent/scene\.json: cannot be read"):
        read_scene_header(tmp_path / "absent")


def test_a_header_that_cannot_be_written_leaves_the_old_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (folder / HEADER_NAME).read_bytes()
    header = read_scene_header(folder)
    with pytest.raises(SceneError, match="training cannot be written"):
        write_scene_header(folder, replace(header, training={"loss": float("nan")}))

    def full_disk(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(SceneError, match=r"scene\.json: cannot be written: No space left"):
        write_scene_header(folder, replace(header, name="new"))
    assert (folder / HEADER_NAME).read_bytes() == before
    assert [file.name for file in folder.iterdir()] == [HEADER_NAME]
