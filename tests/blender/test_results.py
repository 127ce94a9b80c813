"""What a sequence left: its folder opened, its images played, and to which file a task belongs."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import pytest

from unisim_blender.editing.images import rendered as listing
from unisim_blender.features.output import operators as results
from unisim_blender.process import background
from unisim_blender.process.tasks import SequenceTask


@pytest.fixture(autouse=True)
def fresh() -> None:
    """No listing of an earlier test."""
    listing._listed.clear()


def images(folder: Path, frames: range) -> None:
    """Empty images of frames."""
    folder.mkdir(parents=True)
    for frame in frames:
        (folder / f"{frame:06d}.png").touch()


def why_grey(operator: Any) -> str:
    """What a grey button says; "" where it can be pressed."""
    try:
        operator()
    except RuntimeError as fault:
        return str(fault)
    return ""


def test_buttons_are_grey_with_a_reason_before_there_are_results(street: Any, tmp_path: Path) -> None:
    street.unisim.out = "//render"
    assert "Save the .blend first" in why_grey(bpy.ops.unisim.open_output)
    street.unisim.out = str(tmp_path / "out")
    assert "does not exist yet" in why_grey(bpy.ops.unisim.open_output)
    assert "no camera images yet" in why_grey(bpy.ops.unisim.play_result)
    images(tmp_path / "out" / "camera" / "front", range(2))
    listing._listed.clear()
    assert "Python module" in why_grey(bpy.ops.unisim.play_result)
    assert bpy.ops.unisim.open_output.poll()


def test_folder_and_player_get_the_right_paths(street: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    street.unisim.out = str(tmp_path)
    images(tmp_path / "camera" / "front", range(2))
    images(tmp_path / "camera" / "left", range(3, 6))
    opened: list[str] = []
    started: list[list[str]] = []

    def open_path(filepath: str) -> set[str]:
        opened.append(filepath)
        return {"FINISHED"}

    windowed = SimpleNamespace(
        app=SimpleNamespace(binary_path="/blender"), path=bpy.path, data=bpy.data,
        ops=SimpleNamespace(wm=SimpleNamespace(path_open=open_path)),
    )  # fmt: skip
    monkeypatch.setattr(results, "bpy", windowed)
    monkeypatch.setattr("subprocess.Popen", started.append)
    assert bpy.ops.unisim.open_output() == {"FINISHED"} and opened == [str(tmp_path)]
    assert bpy.ops.unisim.play_result(camera="left") == {"FINISHED"}
    assert started[0][0] == "/blender" and started[0][-1] == str(tmp_path / "camera" / "left" / "000003.png")
    assert [item[0] for item in results.camera_items(None, bpy.context)] == ["front", "left"]


def test_a_tasks_line_says_what_it_belongs_to(street: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = str(tmp_path / "first.blend")
    bpy.ops.wm.save_as_mainfile(filepath=file)
    task = SequenceTask([], tmp_path / "out", 4.0)
    monkeypatch.setattr(task, "start", lambda: setattr(task, "code", 0))
    background.launch(task)
    manager = bpy.context.window_manager
    assert manager.unisim_task == "Done: 0 of 4 frames" and background.owner() == str(tmp_path / "out")
    manager.unisim_points = "a sweep of this file"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    manager = bpy.context.window_manager
    assert manager.unisim_task == "Done: 0 of 4 frames" and manager.unisim_points == ""
    assert background.owner() == f"first.blend: {tmp_path / 'out'}"
    bpy.ops.wm.open_mainfile(filepath=file)
    assert background.owner() == str(tmp_path / "out")
    background.newest.clear()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.context.window_manager.unisim_task == "" and background.owner() == ""
