"""`unisim info` on a log, a trained scene and a scenario."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from small_log import small_drive, write_small_log

from unisim_blender.core.cli.commands.info import command
from unisim_blender.core.cli.main import run
from unisim_blender.core.model.scene_file import SceneHeader, write_scene_header
from unisim_blender.core.scenario import save_scenario, scenario_from_json


def info(path: Path) -> tuple[str, dict[str, Any]]:
    """What the command prints, in words and as JSON."""
    words = CliRunner().invoke(command, [str(path)], catch_exceptions=False)
    as_json = CliRunner().invoke(command, [str(path), "--json"], catch_exceptions=False)
    assert words.exit_code == as_json.exit_code == 0
    return words.output, json.loads(as_json.output)


@pytest.fixture
def log_path(tmp_path: Path) -> Path:
    write_small_log(tmp_path / "bend")
    return tmp_path / "bend"


def test_info_of_a_log(log_path: Path) -> None:
    (log_path / "camera/front_camera/01.jpg").unlink()
    words, about = info(log_path)
    assert about["kind"] == "log" and about["name"] == "bend" and about["frames"] == [0, 1, 2, 3]
    assert about["duration_s"] == pytest.approx(0.327)
    assert about["cameras"] == {"front_camera": {"width": 48, "height": 32, "rolling_shutter_s": 0.02, "images": 3}}
    assert about["lidars"] == {"pandar64": {"beams": 4, "columns": 90, "sweeps": 4}}
    assert about["actors"] == {"Car": {"moving": 1, "still": 1}, "Cones": {"moving": 0, "still": 1}}
    assert about["missing"] == ["camera front_camera: no images of 1 of 4 frames: 1"]
    for part in (
        "4 frames (0 to 3), 0.3 s",
        "48 x 32, 3 images",
        "4 beams x 90 columns, 4 sweeps",
        "Car: 1 moving, 1 still",
    ):
        assert part in words
    assert words.endswith("missing:\n    camera front_camera: no images of 1 of 4 frames: 1\n")


def test_info_of_a_trained_scene(tmp_path: Path) -> None:
    drive = small_drive()
    header = SceneHeader(
        tmp_path,
        "bend scene",
        "bend",
        "logs/bend",
        np.zeros(3),
        {},
        {},
        drive,
        {"iterations": 12, "preset": "tiny", "list": []},
    )
    write_scene_header(tmp_path, header)
    words, about = info(tmp_path)
    assert about["kind"] == "trained scene" and about["name"] == "bend scene" and about["trained_on"]["log"] == "bend"
    assert about["training"] == {"iterations": 12, "preset": "tiny"}
    assert about["missing"] == [f"{tmp_path / 'weights.safetensors'} is missing"]
    assert "trained on: bend (logs/bend)" in words and "Cones: 1 still" in words
    (tmp_path / "weights.safetensors").write_bytes(bytes(2_500_000))
    assert info(tmp_path)[1]["weights_mb"] == 2.5 and info(tmp_path)[1]["missing"] == []
    assert info(tmp_path / "scene.json")[1]["kind"] == "trained scene"


def test_info_of_a_scenario(log_path: Path, tmp_path: Path) -> None:
    document = {
        "format": "unisim-scenario",
        "version": 1,
        "name": "one less",
        "log": "bend",
        "scene": "scenes/bend",
        "edits": [{"type": "remove", "actor": "car-1"}, {"type": "remove", "actor": "van"}],
    }
    path = tmp_path / "scenario.json"
    save_scenario(scenario_from_json(document, path), path)
    words, about = info(path)
    assert about["edits"] == {"remove": 2} and about["log"] == str(log_path.resolve())
    assert about["missing"] == [f"{(tmp_path / 'scenes/bend').resolve()} is missing"]
    assert words.startswith("scenario one less:") and "edits: 2 remove" in words


def test_info_of_a_scenario_says_what_its_meshes_leave_out(log_path: Path, tmp_path: Path) -> None:
    """Units that are doubted, materials that are missing, and files that are no mesh; each file once."""
    (tmp_path / "long.obj").write_text("mtllib paint.mtl\nv 0 0 0\nv 4500 0 0\nv 0 1800 0\nf 1 2 3\n")
    (tmp_path / "none.ply").write_text("not a mesh")
    pose = {"position": [0, 0, 0]}
    edits = [
        {"type": "insert_mesh", "mesh": name, "id": str(i), "pose": pose}
        for i, name in enumerate(("long.obj", "long.obj", "none.ply", "gone.glb"))
    ]
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "bend", "edits": edits}
    path = tmp_path / "scenario.json"
    save_scenario(scenario_from_json(document, path), path)
    words, about = info(path)
    folder = tmp_path.resolve()
    assert about["missing"] == [f"{folder / 'gone.glb'} is missing"]
    assert about["meshes"] == [
        f"{folder / 'long.obj'}: its materials 'paint.mtl' are missing",
        f"{folder / 'long.obj'}: its extent is 4.5e+03 m: is its unit the metre?",
        f"{folder / 'none.ply'}: cannot be read as a mesh: it has no PLY header",
    ]
    assert "  meshes:\n" in words


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("gone", None, "there is no such file or folder"),
        ("notes.json", '{"a": 1}', "is neither a log, a trained scene nor a scenario"),
        ("list.json", "[1]", "is neither a log, a trained scene nor a scenario"),
        ("picture.jpg", "not JSON", "is not valid JSON"),
    ],
)
def test_info_of_something_else_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, text: str | None, sentence: str
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    assert run(["info", str(tmp_path / name)]) == 1
    error = capsys.readouterr().err
    assert sentence in error and name in error and len(error.strip().splitlines()) == 1
