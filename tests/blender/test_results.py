"""What a sequence left: its folder opened, its images played, and to which file a task belongs."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import click
import pytest

from unisim_blender.core.cli.commands import render
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario, sequence_formats
from unisim_blender.core.scenario.schema import scenario_schema
from unisim_blender.core.scenario.types import FRAME_FORMATS
from unisim_blender.editing.images import rendered as listing
from unisim_blender.features.drive.export_operators import scenario_of
from unisim_blender.features.operator_bases import nothing_runs
from unisim_blender.features.output import operators as results
from unisim_blender.features.sidebar import draw_task
from unisim_blender.process import background
from unisim_blender.process.tasks import SequenceTask, Task, TrainingTask


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


def test_a_task_belongs_to_a_scene_of_a_file(street: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Panels of other files, other scenes and other kinds do not show it as theirs; they and the buttons say whose it
    is."""
    file, first = str(tmp_path / "first.blend"), bpy.context.scene
    task = SequenceTask([], tmp_path / "out", 4.0)
    monkeypatch.setattr(background, "bpy", windowed(bpy.context, bpy.data))
    monkeypatch.setattr(task, "start", lambda: None)
    background.launch(task)
    background.watch()
    assert drawn(first) == ("progress", "0 of 4 frames, starting", True)
    assert drawn(first, TrainingTask) == ("progress", "No task", False)
    bpy.ops.wm.save_as_mainfile(filepath=file)  # the file has a name now, and the task is its own as before
    other = bpy.data.scenes.new("Other")
    assert drawn(other) == ("label", "Sequence runs for Scene", True)
    first.name = "Renamed"
    assert drawn(first)[0] == "progress"
    first.name = "Scene"
    bpy.context.window_manager.unisim_points = "a sweep of this file"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.context.window_manager.unisim_points == ""
    assert drawn(bpy.context.scene) == ("label", "Sequence runs for first.blend", True)
    assert nothing_runs(bpy.context) == (False, "Sequence runs for first.blend: cancel it or wait until it ends")
    before = set(bpy.data.images)
    (tmp_path / "out/camera/front").mkdir(parents=True)
    write_image(tmp_path / "out/camera/front/000000.png")
    background.tell(task)
    assert set(bpy.data.images) == before  # what runs for another file leaves nothing in this one
    task.code = 0
    background.watch()
    assert drawn(bpy.context.scene) == ("progress", "No task", False)
    bpy.ops.wm.open_mainfile(filepath=file)
    assert drawn(bpy.data.scenes["Scene"]) == ("progress", "Done: 0 of 4 frames", False)
    background.newest.clear()


def test_formats_are_those_of_the_command_line(street: Any, tmp_path: Path) -> None:
    """The panel, the options and the scenario's schema name the same formats, the same by default."""
    named = [item.identifier for item in street.unisim.bl_rna.properties["formats"].enum_items]
    option = next(one for one in render.command.params if one.name == "formats")
    assert isinstance(option.type, click.Choice) and named == [*FRAME_FORMATS, *option.type.choices]
    assert named == scenario_schema()["$defs"]["outputs"]["properties"]["formats"]["items"]["enum"]
    assert street.unisim.formats == set(FRAME_FORMATS)
    _, prepared = plan_scenario(scenario_of(street, tmp_path / "a.json"), RenderOptions(width=32))
    assert prepared.scenario.outputs is not None and prepared.scenario.outputs.formats is None
    street.unisim.formats = {"png", "video", "mcap"}
    plan, prepared = plan_scenario(scenario_of(street, tmp_path / "b.json"), RenderOptions(width=32))
    assert plan.settings.formats == ("png",) and sequence_formats(prepared.scenario) == ("video", "mcap")
    path = tmp_path / "c.json"
    assert bpy.ops.unisim.export_scenario(filepath=str(path)) == {"FINISHED"}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.ops.unisim.import_scenario(filepath=str(path)) == {"FINISHED"}
    assert bpy.context.scene.unisim.formats == {"png", "video", "mcap"}


def test_a_film_is_made_of_what_a_sequence_left(street: Any, tmp_path: Path) -> None:
    street.unisim.out, street.unisim.sequence_width, street.unisim.quality = str(tmp_path / "out"), 32, "fast"
    street.frame_start, street.frame_end = 4, 5
    assert not bpy.ops.unisim.make_film.poll() and not bpy.ops.unisim.open_film.poll()
    assert bpy.ops.unisim.render_sequence() == {"FINISHED"}
    assert bpy.ops.unisim.make_film() == {"FINISHED"}
    task = background.newest[results.FilmTask]
    assert isinstance(task, results.FilmTask) and (task.done, task.total, task.problem) == (2.0, 2.0, "")
    film = results.film_of(street)
    assert film is not None and film.name in ("film.html", "film.mp4")
    assert bpy.ops.unisim.open_film.poll()
    (tmp_path / "out/camera/front_camera/000004.png").unlink()
    with pytest.raises(RuntimeError, match="000004.png: is missing"):
        bpy.ops.unisim.make_film()
    background.newest.clear()


def write_image(path: Path) -> None:
    """A small PNG file."""
    image = bpy.data.images.new("small", 4, 4)
    image.save(filepath=str(path))
    bpy.data.images.remove(image)


def windowed(context: Any, data: Any) -> Any:
    """Blender with a window."""
    timers = SimpleNamespace(register=lambda *_, **how: None, is_registered=lambda _: False)
    app = SimpleNamespace(background=False, timers=timers)
    return SimpleNamespace(app=app, context=context, data=data, path=bpy.path, msgbus=bpy.msgbus)


def drawn(scene: bpy.types.Scene, kind: type[Task] = SequenceTask) -> tuple[str, str, bool]:
    """What a panel draws of its task: how, what, and whether the cross can be pressed."""
    said: list[tuple[str, str]] = []
    layout: Any = SimpleNamespace(
        row=lambda **_: layout,
        column=lambda **_: layout,
        label=lambda text, **_: said.append(("label", text)),
        progress=lambda text, **_: said.append(("progress", text)),
        operator=lambda name, **_: None,
    )
    draw_task(layout, scene, kind)
    (shown,) = said
    return *shown, layout.enabled
