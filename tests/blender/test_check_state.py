"""Warnings are saved with the scene, and are marked when what they are about has changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import calls, imported

from unisim_blender.bridge.objects.animation import curves_of
from unisim_blender.bridge.objects.imported import KINDS_OF_DRIVE, imported_objects, source_of
from unisim_blender.bridge.sampling.edit_state import edit_state
from unisim_blender.features import check


def car(scene: Any, moving: bool = False) -> Any:
    """A car that stands, or drives."""
    actors = source_of(scene).drive.actors
    return imported(
        scene, "ACTOR", next(u for u, a in sorted(actors.items()) if a.is_moving == moving and "Car" in a.label)
    )


def test_warnings_survive_saving_with_time_place_and_object(street: Any, tmp_path: Path) -> None:
    one = car(street)
    one.location.z += 2.0
    name, place = one.name, np.array(one.location)
    assert bpy.ops.unisim.check() == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "drive.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert not bpy.context.scene.unisim_check.state
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "drive.blend"))
    scene = bpy.context.scene
    (warning,) = [w for w in scene.unisim_check.warnings if w.name == name]
    assert "above the ground" in warning.text and warning.time_s == pytest.approx(
        source_of(scene).drive.time_s[warning.frame], abs=1e-6
    )
    assert np.abs(np.array(warning.place) - place).max() < 1e-3
    check.compare()
    assert not check.is_outdated(scene)
    scene.frame_set(7)
    assert bpy.ops.unisim.go_to(object_name=warning.name, frame=warning.frame, place=warning.place) == {"FINISHED"}
    assert bpy.context.active_object.name == name and scene.frame_current == warning.frame


def test_an_edit_marks_the_warnings_and_another_check_takes_the_mark_away(street: Any) -> None:
    bpy.ops.unisim.check()
    check.compare()
    assert not check.is_outdated(street)
    car(street).location.x += 0.5
    check.compare()
    assert check.is_outdated(street)
    bpy.ops.unisim.check()
    assert not check.is_outdated(street)


def test_what_is_no_edit_changes_no_state(street: Any) -> None:
    before = edit_state(street)
    street.frame_set(9)
    car(street).select_set(True)
    street.unisim.quality = "fine"
    street.camera = None
    bpy.context.view_layer.update()
    assert edit_state(street) == before


def keyed(scene: Any) -> None:
    """Retime a car that drives."""
    one = car(scene, moving=True)
    for other in bpy.context.selected_objects:
        other.select_set(False)
    one.select_set(True)
    bpy.ops.unisim.retime_actor(mode="DELAY", seconds=0.3)


@pytest.mark.parametrize(
    "edit",
    [
        lambda scene: setattr(car(scene), "hide_render", True),
        lambda scene: bpy.data.objects.remove(car(scene)),
        lambda scene: setattr(car(scene, moving=True), "location", (0.0, 1.0, 0.0)),
        keyed,
        lambda scene: setattr(next(imported_objects(scene, "CAMERA")).data, "lens", 20.0),
        lambda scene: setattr(car(scene).unisim, "look", "another"),
        lambda scene: setattr(next(imported_objects(scene, "CAMERA")).unisim, "sees_ego_body", "ALWAYS"),
        lambda scene: setattr(car(scene).unisim, "row", "a row with one copy more"),
        lambda scene: setattr(car(scene).unisim, "maneuvers", "a maneuver that makes the same keys"),
        lambda scene: car(scene).constraints.new("COPY_LOCATION"),
        lambda scene: setattr(bpy.context.view_layer.layer_collection.children[-1], "exclude", True),
        lambda scene: setattr(scene.render, "frame_map_new", 50),
    ],
)
def test_every_edit_changes_the_state(street: Any, edit: Any) -> None:
    before = edit_state(street)
    edit(street)
    bpy.context.view_layer.update()
    assert edit_state(street) != before


def test_undo_brings_the_state_back(street: Any) -> None:
    bpy.ops.unisim.check()
    before = edit_state(street)
    bpy.ops.ed.undo_push(message="checked")
    car(street).location.x += 0.5
    bpy.ops.ed.undo_push(message="moved")
    assert edit_state(bpy.context.scene) != before
    bpy.ops.ed.undo()
    assert edit_state(bpy.context.scene) == before


def keys_of(obj: Any) -> list[Any]:
    """All keys of an object's curves."""
    return [key for curve in curves_of(obj) for key in curve.keyframe_points]


def test_the_state_does_no_work_for_each_key(street: Any) -> None:
    """It is asked for while a person edits; a drive has thousands of keys, which are read all at once."""
    objects = list(imported_objects(street, *KINDS_OF_DRIVE, "TRAJECTORY"))
    one = max(objects, key=lambda obj: len(keys_of(obj)))
    before, keys = calls(lambda: edit_state(street)), len(keys_of(one))
    for frame in range(1000, 1100):
        one.keyframe_insert("location", frame=frame)
    assert len(keys_of(one)) >= keys + 300
    assert calls(lambda: edit_state(street)) <= before + 30
    assert before < 500 * len(objects)


def test_a_deleted_object_is_named(street: Any, capfd: pytest.CaptureFixture[str]) -> None:
    assert bpy.ops.unisim.go_to(object_name="gone", frame=3) == {"FINISHED"}
    assert street.frame_current == 3 and '"gone" no longer exists' in "".join(capfd.readouterr())
