"""A scenario's file with what it names: the log, the trained scene, another scene."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from turning_drive import turning_drive

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.model.scene_file import SceneHeader, write_scene_header
from unisim_blender.core.prepare import scenario as prepare
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.world.drive import Appearance, Drive
from unisim_blender.core.world.drive_json import drive_to_json

REMOVE = {"type": "remove", "actor": "van"}


def write_scenario(folder: Path, **members: Any) -> Path:
    file = folder / "s.json"
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "log", "edits": [REMOVE]} | members
    file.write_text(json.dumps(document))
    return file


def write_scene(folder: Path, drive: Drive, name: str = "scene") -> None:
    (folder / name).mkdir()
    header = SceneHeader(folder / name, name, drive.name, "../log", drive.world_origin, {}, {}, drive, {})
    write_scene_header(folder / name, header)


def refined(drive: Drive) -> Drive:
    """The drive as training leaves it: the car elsewhere by centimetres, half of the frames, one camera."""
    car = drive.actors["car"]
    nudged = replace(car.world_from_actor, positions=car.world_from_actor.positions + 0.03)
    return replace(
        drive,
        frames=drive.frames[::2],
        lidars={},
        actors={**drive.actors, "car": replace(car, world_from_actor=nudged)},
    )


@pytest.fixture
def with_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Drive:
    """A folder beside which the log ``log`` can be opened."""
    (tmp_path / "log").mkdir()
    drive = turning_drive()
    monkeypatch.setattr(prepare, "open_log", lambda path: SimpleNamespace(drive=drive, path=path))
    return drive


def test_without_a_scene_the_logs_drive_is_edited(tmp_path: Path, with_log: Drive) -> None:
    scenario, recorded, edited, scene, *_ = prepare_scenario(write_scenario(tmp_path))
    assert scenario.path == tmp_path / "s.json"
    assert recorded is with_log
    assert list(edited.actors) == ["car", "late"]
    assert scene is None


def test_a_scenes_tracklets_and_the_logs_frames_and_sensors(tmp_path: Path, with_log: Drive) -> None:
    write_scene(tmp_path, refined(with_log))
    result = prepare_scenario(write_scenario(tmp_path, scene="scene"))
    assert result.scene is not None and result.scene.path == tmp_path / "scene"
    assert result.recorded.frames == with_log.frames
    assert list(result.recorded.lidars) == ["top"]
    np.testing.assert_array_equal(
        result.edited.actors["car"].world_from_actor.positions, with_log.actors["car"].world_from_actor.positions + 0.03
    )
    truth = prepare_scenario(write_scenario(tmp_path, scene="scene"), refined=False)
    assert truth.recorded is with_log


def test_where_the_log_is_not_there_the_scenes_drive_does(tmp_path: Path) -> None:
    drive = refined(turning_drive())
    write_scene(tmp_path, drive)
    result = prepare_scenario(write_scenario(tmp_path, scene="scene"))
    assert drive_to_json(result.recorded) == drive_to_json(drive)
    assert list(result.edited.actors) == ["car", "late"]


def test_a_trained_scene_is_a_scenario_without_edits(tmp_path: Path, with_log: Drive) -> None:
    write_scene(tmp_path, refined(with_log))
    result = prepare_scenario(tmp_path / "scene")
    assert (result.scenario.name, result.scenario.edits) == ("scene", ())
    assert result.scene is not None and result.scene.path == tmp_path / "scene"
    assert result.edited.actors.keys() == with_log.actors.keys() and result.recorded.frames == with_log.frames


def test_an_actor_of_another_scene(tmp_path: Path, with_log: Drive) -> None:
    write_scene(tmp_path, with_log, "scene")
    write_scene(tmp_path, with_log, "other")
    insert = {"type": "insert", "actor": "car", "scene": "other", "id": "b", "pose": {"position": [0, 0, 0]}}
    edited = prepare_scenario(write_scenario(tmp_path, scene="scene", edits=[insert])).edited
    assert edited.actors["b"].appearance == Appearance("car", str(tmp_path / "other"))


def refusal(file: Path) -> str:
    with pytest.raises(UnisimError) as caught:
        prepare_scenario(file)
    return str(caught.value)


def test_a_street_that_was_not_made_yet_says_how(tmp_path: Path) -> None:
    log = {"path": "street", "street": {"frames": 20, "seed": 3}}
    expected = (
        f"log: there is none at {tmp_path}/street; make it with: unisim synth {tmp_path}/street --frames 20 --seed 3"
    )
    assert refusal(write_scenario(tmp_path, log=log)) == f"{tmp_path}/s.json: {expected}"
    assert refusal(write_scenario(tmp_path)) == f"{tmp_path}/s.json: log: there is none at {tmp_path}/log"


def test_a_scene_that_is_not_there_is_named(tmp_path: Path, with_log: Drive) -> None:
    assert f"{tmp_path}/nowhere/scene.json: cannot be read" in refusal(write_scenario(tmp_path, scene="nowhere"))


def test_a_scene_of_another_drive_is_refused(tmp_path: Path, with_log: Drive) -> None:
    ego = with_log.world_from_ego
    other = replace(with_log, world_from_ego=replace(ego, positions=ego.positions + [0, 5, 0]))
    write_scene(tmp_path, other)
    message = refusal(write_scenario(tmp_path, scene="scene"))
    assert (
        f"s.json: scene: {tmp_path}/scene: was trained on another drive than {tmp_path}/log, whose vehicle is 5.0 m away"
        in message
    )


def test_a_scene_with_another_origin_is_refused(tmp_path: Path, with_log: Drive) -> None:
    write_scene(tmp_path, replace(with_log, world_origin=np.array([0.5, 0, 0])))
    message = refusal(write_scenario(tmp_path, scene="scene"))
    assert f"s.json: scene: {tmp_path}/scene: has its origin at [0.5, 0.0, 0.0], {tmp_path}/log at" in message
