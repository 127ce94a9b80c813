"""Files of boxes: exact round trips, logs that are named by one, and refusals that name the place in the file."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner
from small_log import small_drive, write_small_log
from small_training import SMALL

from unisim_blender.core.cli.main import run, unisim
from unisim_blender.core.data.log import log_digest
from unisim_blender.core.errors import LogError, SceneError
from unisim_blender.core.formats.boxes import with_boxes
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.tracks.box_file import (
    Track,
    boxes_schema,
    default_path,
    halves,
    joined,
    read_boxes,
    write_boxes,
)
from unisim_blender.core.world.drive_json import drive_to_json


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A log without boxes, ``bare``, and beside it boxes with two of the three actors that it is written with."""
    drive = small_drive()
    write_small_log(tmp_path / "bare", replace(drive, actors={}))
    actors = [drive.actors["car-1"], replace(drive.actors["van"], start_s=-np.inf, end_s=np.inf)]
    tracks = [Track(actors[0], 0.75, "lidar", 40, 4, (0.0, 0.103)), Track(actors[1])]
    write_boxes(tmp_path / "bare.boxes.json", open_log(tmp_path / "bare"), tracks, "this test")
    return tmp_path


def changed(file: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """The file, after a change of its document."""
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))
    return file


def test_a_file_of_boxes_comes_back_exactly(folder: Path) -> None:
    path = default_path(folder / "bare")
    boxes = read_boxes(path)
    first, second = boxes.tracks
    assert (first.certainty, first.source, first.returns, first.sweeps) == (0.75, "lidar", 40, 4)
    assert first.drawn_s == (0.0, 0.103) and second == Track(second.actor) and boxes.source == "this test"
    before = path.read_bytes()
    write_boxes(path, open_log(path), boxes.tracks, boxes.source)
    assert path.read_bytes() == before
    jsonschema.validate(json.loads(before), boxes_schema())
    assert not list(folder.glob(".*"))


def test_the_folder_of_a_file_of_boxes_is_made(folder: Path) -> None:
    log = open_log(folder / "bare")
    path = folder / "new" / "folder" / "boxes.json"
    write_boxes(path, log, (), "a test")
    assert read_boxes(path).tracks == ()


def test_a_file_of_boxes_is_a_log(folder: Path) -> None:
    bare, boxed = open_log(folder / "bare"), open_log(folder / "bare.boxes.json")
    assert not bare.drive.actors and list(boxed.drive.actors) == ["car-1", "van"]
    car = small_drive().actors["car-1"]
    assert boxed.drive.actors["car-1"].world_from_actor.content() == car.world_from_actor.content()
    assert boxed.drive.actors["van"].start_s == -np.inf and not boxed.drive.actors["van"].is_moving
    assert {**drive_to_json(boxed.drive), "actors": {}} == drive_to_json(bare.drive)
    assert (boxed.image("front_camera", 1) == bare.image("front_camera", 1)).all()
    assert (boxed.sweep("pandar64", 2).points == bare.sweep("pandar64", 2).points).all()
    digest = log_digest(boxed)
    changed(folder / "bare.boxes.json", lambda d: d["tracks"].pop())
    assert log_digest(open_log(folder / "bare.boxes.json")) != digest
    assert list(prepare_scenario(folder / "bare.boxes.json").edited.actors) == ["car-1"]


def test_boxes_of_another_folder_are_given_to_a_log(folder: Path) -> None:
    write_small_log(folder / "labelled")
    path = with_boxes(folder / "labelled", folder / "bare.boxes.json")
    assert list(open_log(path).drive.actors) == ["car-1", "van"] and path.parent != folder
    assert with_boxes(folder / "bare", folder / "bare.boxes.json") == folder / "bare.boxes.json"
    args = ["info", str(folder / "labelled"), "--boxes", str(folder / "bare.boxes.json"), "--json"]
    about = json.loads(CliRunner().invoke(unisim, args, catch_exceptions=False).output)
    assert about["actors"] == {"Car": {"moving": 1, "still": 1}}


def test_a_cut_world_moves_boxes_along(folder: Path) -> None:
    shifted = changed(folder / "bare.boxes.json", lambda d: d["world_origin"].__setitem__(0, d["world_origin"][0] + 3))
    document = json.loads(shifted.read_text())
    with pytest.raises(LogError, match=r"another drive than bend, whose vehicle is 3"):
        document["ego"]["positions"][0][0] += 30
        shifted.write_text(json.dumps(document))
        open_log(shifted)
    document["ego"]["positions"][0][0] -= 33
    shifted.write_text(json.dumps(document))
    car = small_drive().actors["car-1"].world_from_actor.positions
    assert open_log(shifted).drive.actors["car-1"].world_from_actor.positions == pytest.approx(car + [3, 0, 0])


def test_boxes_without_optional_members(folder: Path) -> None:
    still = [[8.0, -4, 1], [8.1, -4, 1], [8.0, -4, 1]]
    short = {
        "id": "x",
        "class": "Car",
        "size_m": [4, 2, 1.5],
        "times_s": [0.0, 0.1, 0.2],
        "positions": still,
        "quaternions_wxyz": [[1, 0, 0, 0]] * 3,
    }
    path = folder / "team.json"
    path.write_text(json.dumps({"format": "unisim-boxes", "version": 1, "tracks": [short]}))
    jsonschema.validate(json.loads(path.read_text()), boxes_schema())
    (actor,) = open_log(with_boxes(folder / "bare", path)).drive.actors.values()
    assert not actor.is_moving and actor.world_from_actor.positions.tolist() == [[8.0, -4, 1]]
    assert (actor.start_s, actor.end_s) == (-0.05, 0.25)
    with pytest.raises(LogError, match="names no log"):
        open_log(path)
    path.write_text(json.dumps({"format": "unisim-boxes", "version": 1, "tracks": []}))
    assert not open_log(with_boxes(folder / "bare", path)).drive.actors


def test_what_a_person_noted_is_written_split_and_merged(folder: Path) -> None:
    car = small_drive().actors["car-1"]
    times = car.world_from_actor.times_s
    middle = float(times[len(times) // 2])
    track = Track(
        car, drawn_s=(float(times[0]), middle), unsure=((float(times[0]), 0.2),), dismissed=((middle, "jump"),)
    )
    path = folder / "noted.boxes.json"
    write_boxes(path, open_log(folder / "bare"), (track,), "a person")
    jsonschema.validate(json.loads(path.read_text()), boxes_schema())
    (read,) = read_boxes(path).tracks
    assert (read.drawn_s, read.unsure, read.dismissed) == (track.drawn_s, track.unsure, track.dismissed)
    first, second = halves(track, middle, "other")
    assert (first.drawn_s, first.unsure, first.dismissed) == ((float(times[0]),), track.unsure, ())
    assert (second.drawn_s, second.unsure, second.dismissed) == ((middle,), (), track.dismissed)
    assert second.actor.uid == "other" and first.actor.end_s < second.actor.start_s == middle
    whole = joined(first, (second,))
    assert (whole.drawn_s, whole.unsure, whole.dismissed) == (track.drawn_s, track.unsure, track.dismissed)
    assert whole.actor.world_from_actor.times_s.tolist() == times.tolist() and whole.actor.uid == "car-1"
    assert (whole.actor.start_s, whole.actor.end_s) == (car.start_s, car.end_s) and whole.actor.is_moving


def test_five_hundred_boxes(folder: Path) -> None:
    van, path = small_drive().actors["van"], folder / "bare.boxes.json"
    tracks = [Track(replace(van, uid=f"van-{number}")) for number in range(500)]
    write_boxes(path, open_log(folder / "bare"), tracks, "many")
    assert list(open_log(path).drive.actors) == [f"van-{number}" for number in range(500)]


FAULTS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "size": (lambda d: d["tracks"][0]["size_m"].__setitem__(1, -2), r"tracks\[0\].size_m: must be above 0, not \[4.5"),
    "times": (lambda d: d["tracks"][0]["times_s"].reverse(), r"tracks\[0\]: key 1 of a trajectory at .* is not later"),
    "nan": (
        lambda d: d["tracks"][0]["positions"][1].__setitem__(0, np.nan),
        r"positions\[1\]\[0\]: nan is not a finite",
    ),
    "rows": (lambda d: d["tracks"][0]["positions"].pop(), r"tracks\[0\].positions: must be 4 x 3 numbers"),
    "turn": (
        lambda d: d["tracks"][0]["quaternions_wxyz"].__setitem__(2, [0, 0, 0, 0]),
        "quaternion of length 0, not 1",
    ),
    "id": (lambda d: d["tracks"][1].update(id="car-1"), r"tracks\[1\].id: 'car-1' is the id of an earlier track"),
    "no keys": (
        lambda d: d["tracks"][1].update(times_s=[], positions=[], quaternions_wxyz=[]),
        r"tracks\[1\].times_s: is empty",
    ),
    "certainty": (lambda d: d["tracks"][0].update(certainty=70), r"tracks\[0\].certainty: must be in 0..1, not 70"),
    "class": (lambda d: d["tracks"][0].pop("class"), r'tracks\[0\]: "class" is missing'),
    "member": (
        lambda d: d["tracks"][0].update(heading=1),
        r"tracks\[0\]: has a member 'heading', which is none of id,",
    ),
    "bounds": (lambda d: d["tracks"][0].update(end_s=-9), r"tracks\[0\].end_s: -9.0 is before start_s, -0.05"),
    "version": (lambda d: d.update(version=2), r"version: is 2; this program reads 1"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_broken_file_is_refused_by_its_place(folder: Path, fault: str) -> None:
    change, sentence = FAULTS[fault]
    path = changed(folder / "bare.boxes.json", change)
    with pytest.raises(LogError, match=f"{re.escape(str(path))}: .*{sentence}"):
        open_log(path)
    if fault not in ("times", "nan", "rows", "turn", "id", "bounds"):  # which a schema cannot say
        assert not jsonschema.Draft202012Validator(boxes_schema()).is_valid(json.loads(path.read_text()))


def test_a_file_that_ends_early_and_a_log_that_is_gone(folder: Path) -> None:
    path = folder / "bare.boxes.json"
    whole = path.read_text()
    path.write_text(whole[: len(whole) // 2])
    with pytest.raises(LogError, match="is not valid JSON"):
        open_log(path)
    path.write_text(whole)
    later = changed(path, lambda d: [t.update(start_s=50, end_s=60) for t in d["tracks"]])
    with pytest.raises(LogError, match="are there from 50.0 to 60.0 s, the drive bend lasts from 0.0 to 0.3 s"):
        open_log(later)
    path.write_text(whole)
    (folder / "bare").rename(folder / "moved")
    with pytest.raises(LogError, match="log: there is none at .*bare"):
        open_log(path)
    changed(path, lambda d: d.update(log=path.name))
    with pytest.raises(LogError, match="is a file of boxes, too"):
        open_log(path)


def test_a_scene_has_the_boxes_that_it_was_trained_on(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from unisim_blender.core.training.loop import train

    scene, path = folder / "scenes" / "bend", folder / "bare.boxes.json"
    scene.parent.mkdir()
    header = train(open_log(path), replace(SMALL, iterations=2), scene, quiet=True)
    assert header.log_path == "boxes.json" and list(header.drive.actors) == ["car-1", "van"]
    changed(path, lambda d: d["tracks"].pop())
    assert list(open_log(scene / "boxes.json").drive.actors) == ["car-1", "van"]
    prepared = prepare_scenario(scene)
    assert list(prepared.recorded.actors) == ["car-1", "van"] and prepared.log_path == scene / "boxes.json"
    with pytest.raises(SceneError, match="boxes.json: has other boxes than"):
        train(open_log(path), replace(SMALL, iterations=4), scene, resume=True, quiet=True)
    assert run(["render", str(scene), "--boxes", str(path), "--out", str(folder / "o")]) == 1
    assert "shows the actors that it was trained on" in capsys.readouterr().err
