"""What a path is that was dropped or chosen."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.rigs import FORMAT as RIG_FORMAT
from unisim_blender.core.scenario import FORMAT
from unisim_blender.editing.sampled.source import format_of, recognised


def written(path: Path, text: str = "") -> Path:
    """A file with that text."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def rollout(folder: Path) -> Path:
    """A folder with the files of a rollout, by name."""
    written(folder / "steps.jsonl")
    written(folder / "scenario.json", json.dumps({"format": FORMAT}))
    return folder


def test_files_tell_what_they_are(tmp_path: Path) -> None:
    rig = written(tmp_path / "a" / "rig.json", json.dumps({"format": RIG_FORMAT}))
    scenario = written(tmp_path / "a" / "left.json", json.dumps({"format": FORMAT}))
    scene = written(tmp_path / "b" / "scene.json", "{}")
    weights = written(tmp_path / "b" / "weights.safetensors")
    assert recognised(rig) == [("rig", rig)]
    assert recognised(scenario) == [("scenario", scenario)]
    assert recognised(scene) == recognised(weights) == recognised(scene.parent) == [("scene", scene.parent)]
    driven = rollout(tmp_path / "c")
    scores = written(driven / "scores.json", "{}")
    assert recognised(driven) == recognised(driven / "scenario.json") == recognised(scores) == [("rollout", driven)]


def test_what_says_nothing_is_tried_as_a_scenario(tmp_path: Path) -> None:
    for text in ("[1]", "{", '{"format": 3}'):
        path = written(tmp_path / "other.json", text)
        assert recognised(path) == [("scenario", path)]
    assert format_of(tmp_path / "none.json") == ""


def test_every_file_inside_a_log_is_the_log(street_log: Path) -> None:
    files = [path for path in street_log.rglob("*") if path.is_file()]
    assert {".jpg", ".json", ".gz"} <= {path.suffix for path in files}
    assert all(recognised(path) == [("log", street_log)] for path in files)


def test_a_scenario_beside_a_log_stays_one(street_log: Path, tmp_path: Path) -> None:
    """A rendered sequence has its scenario beside a log's folders."""
    inside = written(street_log / "left.json", json.dumps({"format": FORMAT}))
    try:
        assert recognised(inside) == [("scenario", inside)]
    finally:
        inside.unlink()


def test_the_folder_around_holds_what_lies_in_it(street_log: Path, tmp_path: Path) -> None:
    one = tmp_path / "data" / "drives" / "002"
    shutil.copytree(street_log, one)
    assert recognised(tmp_path / "data") == recognised(one.parent) == recognised(one) == [("log", one)]
    scene = written(tmp_path / "data" / "scene" / "scene.json", "{}").parent
    driven = rollout(tmp_path / "data" / "rollouts" / "idm 1")
    written(tmp_path / "data" / "left.json", json.dumps({"format": FORMAT}))
    assert recognised(tmp_path / "data") == [("log", one), ("rollout", driven), ("scene", scene)]


def test_a_folder_with_scenarios_alone_holds_them(tmp_path: Path) -> None:
    first, second = (written(tmp_path / name, json.dumps({"format": FORMAT})) for name in ("a.json", "b.json"))
    written(tmp_path / "c.json", "{}")
    assert recognised(tmp_path) == [("scenario", first), ("scenario", second)]


def test_what_holds_nothing_is_one_sentence(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(UnisimError, match=f"^{path}: "):
            recognised(path)
