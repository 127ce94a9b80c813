"""Which operator imports a dropped file."""

from __future__ import annotations

import json
from pathlib import Path

from unisim_blender.core.rigs import FORMAT as RIG_FORMAT
from unisim_blender.core.scenario import FORMAT
from unisim_blender.editing.sampled.source import dropped, format_of


def written(path: Path, text: str) -> Path:
    """A file with that text."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_files_tell_what_they_are(tmp_path: Path) -> None:
    rig = written(tmp_path / "rig.json", json.dumps({"format": RIG_FORMAT}))
    scenario = written(tmp_path / "left.json", json.dumps({"format": FORMAT}))
    scene = written(tmp_path / "scene.json", "{}")
    assert dropped(rig) == ("apply_rig", rig)
    assert dropped(scenario) == ("import_scenario", scenario)
    assert dropped(scene) == ("import_scene", scene)


def test_what_says_nothing_is_tried_as_a_scenario(tmp_path: Path) -> None:
    for text in ("[1]", "{", '{"format": 3}'):
        path = written(tmp_path / "other.json", text)
        assert dropped(path) == ("import_scenario", path)
    assert format_of(tmp_path / "none.json") == ""


def test_a_file_inside_a_log_is_the_log(street_log: Path) -> None:
    image = next(street_log.rglob("*.jpg"))
    assert dropped(image) == ("import_log", street_log)


def test_a_scenario_beside_a_log_stays_one(street_log: Path, tmp_path: Path) -> None:
    """A rendered sequence has its scenario beside a log's folders."""
    inside = written(street_log / "left.json", json.dumps({"format": FORMAT}))
    try:
        assert dropped(inside) == ("import_scenario", inside)
    finally:
        inside.unlink()
