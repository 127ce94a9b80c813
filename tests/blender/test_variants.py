"""Variants: scenes of one drive that do not change each other, with the same ids; compared, rendered, exported,
deleted."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from edit_cases import CASES, lines, press, standing, update
from helpers import SAMPLE, content, driving, read, select

from unisim_blender.bridge.changes.variants import delete_variant, variants_of
from unisim_blender.bridge.objects.imported import imported_objects, is_copy
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.scenario import load_scenario
from unisim_blender.editing.edits.variants import differences, file_names, free_variant_name
from unisim_blender.features.drive.export_operators import scenario_of
from unisim_blender.features.variants.operators import VariantRun, VariantsTask
from unisim_blender.process import background


@pytest.fixture(autouse=True)
def one_task() -> Iterator[None]:
    """No task is left over."""
    yield
    background.running.clear()
    background.newest.clear()


def show(scene: Any) -> Any:
    """Show a variant; the scene by its name, for undo leaves no other hold on it."""
    assert bpy.ops.unisim.show_variant(name=scene if isinstance(scene, str) else scene.name) == {"FINISHED"}
    return bpy.context.scene


def new(name: str = "") -> Any:
    """A new variant, which is shown."""
    assert bpy.ops.unisim.new_variant(**({"name": name} if name else {})) == {"FINISHED"}
    return bpy.context.scene


def test_a_variant_of_an_unedited_drive_is_unedited(street: Any) -> None:
    variant = new()
    assert variant.name == "Variant 2" and variants_of(variant) == [street, variant]
    for scene in (street, variant):
        assert read(show(scene)).edits == () and read(scene).sensors is None
        assert lines(scene) == ()
        assert not any(is_copy(scene, one) for one in imported_objects(scene, "ACTOR", "EGO", "CAMERA", "LIDAR"))
    assert not set(street.objects) & set(variant.objects)


@pytest.mark.parametrize("name", CASES)
def test_a_variant_is_the_same_scenario(street: Any, name: str) -> None:
    CASES[name][0](street)
    update()
    before, listed = content(scenario_of(street, Path("/tmp/a.json"))), lines(street)
    variant = new()
    found = content(scenario_of(variant, Path("/tmp/a.json")))
    assert found == before
    assert [(line.key, line.what, line.who) for line in lines(variant)] == [
        (line.key, line.what, line.who) for line in listed
    ]
    assert list(differences(listed, lines(variant))) == []


@pytest.mark.parametrize("name", CASES)
def test_editing_one_does_not_change_the_other(street: Any, name: str) -> None:
    """The edit is made in the variant, and the first stays empty; then it is made in the first and reverted in the
    variant."""
    variant = new()
    CASES[name][0](variant)
    update()
    made = content(read(variant))
    assert made != ([], None, {})
    assert content(read(show(street))) == ([], None, {})
    CASES[name][0](street)
    update()
    edited = content(read(street))
    show(variant)
    press(bpy.ops.unisim.revert_edit, lines(variant)[0])
    assert content(read(variant)) == ([], None, {})
    assert content(read(show(street))) == edited


def test_whatever_the_preferences_copy(street: Any) -> None:
    preferences = bpy.context.preferences.edit
    kinds = ("action", "camera", "mesh")
    before = [getattr(preferences, f"use_duplicate_{kind}") for kind in kinds]
    for kind in kinds:
        setattr(preferences, f"use_duplicate_{kind}", False)
    try:
        variant = new()
    finally:
        for kind, value in zip(kinds, before, strict=True):
            setattr(preferences, f"use_duplicate_{kind}", value)
    select(driving(variant))
    bpy.ops.unisim.retime_actor(mode="DELAY", seconds=0.6)
    CASES["camera lens"][0](variant)
    update()
    assert len(lines(variant)) == 2
    assert lines(show(street)) == ()


def test_muted_edits_are_each_variants_own(street: Any) -> None:
    for name in ("moved standing", "copied", "mesh", "ego"):
        CASES[name][0](street)
        update()
    before = content(read(street))
    for part in ("MOVE", "COPY", "MESH", "EGO"):
        press(bpy.ops.unisim.mute_edit, next(line for line in lines(street) if line.part == part))
    variant = new()
    assert content(read(variant)) == ([], None, {}) and len(lines(variant)) == 4
    for part in ("MOVE", "COPY", "MESH", "EGO"):
        press(bpy.ops.unisim.mute_edit, next(line for line in lines(variant) if line.part == part))
    unmuted = content(read(variant))
    assert [edit for edit in unmuted[0] if edit[0] != "InsertMesh"] == [
        edit for edit in before[0] if edit[0] != "InsertMesh"
    ]
    assert len(unmuted[0]) == len(before[0])
    assert all(line.muted >= 0 for line in lines(show(street)))
    assert content(read(street)) == ([], None, {})
    for part in ("MOVE", "COPY", "MESH", "EGO"):
        press(bpy.ops.unisim.mute_edit, next(line for line in lines(street) if line.part == part))
    assert content(read(street)) == before
    show(variant)
    for part in ("MOVE", "COPY", "MESH", "EGO"):
        press(bpy.ops.unisim.revert_edit, next(line for line in lines(variant) if line.part == part))
    assert content(read(variant)) == ([], None, {})
    assert content(read(show(street))) == before


def test_ids_stay_when_the_first_variant_is_deleted(street: Any, tmp_path: Path) -> None:
    CASES["copied"][0](street)
    CASES["camera added"][0](street)
    update()
    before = content(read(street))
    objects = len(bpy.data.objects)
    variant = new("Second")
    show(street)
    assert bpy.ops.unisim.delete_variant() == {"FINISHED"}
    variant = bpy.context.scene
    assert variant.name == "Second" and len(bpy.data.scenes) == 1 and len(bpy.data.objects) == objects
    assert content(read(variant)) == before
    assert not bpy.ops.unisim.delete_variant.poll()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "second.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "second.blend"))
    assert content(read(bpy.context.scene)) == before
    for line in lines(bpy.context.scene):
        press(bpy.ops.unisim.revert_edit, line)
    assert content(read(bpy.context.scene)) == ([], None, {})


def test_a_copy_made_in_a_variant_has_an_id_of_its_own(street: Any) -> None:
    CASES["copied"][0](street)
    variant = new()
    select(next(one for one in imported_objects(variant, "ACTOR") if is_copy(variant, one)))
    bpy.ops.object.duplicate_move(TRANSFORM_OT_translate={"value": (0.0, 4.0, 0.0)})
    update()
    ids = [getattr(edit, "id", "") for edit in read(variant).edits]
    assert len(set(ids)) == 2
    assert getattr(read(show(street)).edits[0], "id", "none") in ids
    (extra,) = differences(lines(variant), lines(street))
    assert extra.there is None and extra.here is not None and extra.here.part == "COPY"


def test_importing_again_into_a_variant(street: Any) -> None:
    driving(street).location.y = 1.0
    variant = new()
    count = len(variant.objects)
    standing(variant).location.x += 1.0
    update()
    before = content(read(variant))
    assert bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json")) == {"FINISHED"}
    assert content(read(variant)) == before and len(variant.objects) == count
    assert len(read(show(street)).edits) == 1


def test_undo_across_scenes(street: Any) -> None:
    first = street.name
    driving(street).location.y = 1.0
    bpy.ops.ed.undo_push(message="moved in the first")
    variant = new("Second")
    bpy.ops.ed.undo_push(message="new variant")
    driving(variant).location.y = 2.0
    bpy.ops.ed.undo_push(message="moved in the second")
    show(first)
    bpy.ops.ed.undo()
    assert driving(bpy.data.scenes["Second"]).location.y == pytest.approx(1.0)
    assert [line.what for line in lines(bpy.data.scenes["Second"])] == ["Moved 1.0 m left"]
    bpy.ops.ed.undo()
    assert list(bpy.data.scenes.keys()) == [first] and bpy.context.scene.name == first
    assert [line.what for line in lines(bpy.context.scene)] == ["Moved 1.0 m left"]
    bpy.ops.ed.redo()
    bpy.ops.ed.redo()
    assert [line.what for line in lines(bpy.data.scenes["Second"])] == ["Moved 2.0 m left"]
    assert content(read(show("Second")))[0]
    bpy.ops.ed.undo_push(message="shown")
    assert bpy.ops.unisim.delete_variant() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="deleted")
    bpy.ops.ed.undo()
    assert set(bpy.data.scenes.keys()) == {first, "Second"}
    assert [line.what for line in lines(bpy.data.scenes["Second"])] == ["Moved 2.0 m left"]


def test_names(street: Any) -> None:
    new("A")
    assert bpy.ops.unisim.rename_variant(name="Cut-in") == {"FINISHED"}
    assert bpy.context.scene.name == "Cut-in"
    for wrong in (street.name, "x" * 80):
        with pytest.raises(RuntimeError, match="has this name|is longer"):
            bpy.ops.unisim.rename_variant(name=wrong)
        with pytest.raises(RuntimeError, match="has this name|is longer"):
            bpy.ops.unisim.new_variant(name=wrong)
    assert len(bpy.data.scenes) == 2
    assert (
        free_variant_name("Variant 2", bpy.data.scenes) == "Variant 2"
        and free_variant_name("Cut-in", bpy.data.scenes) == "Cut-in 1"
    )
    new("Variant 2")
    assert free_variant_name("Variant 2", bpy.data.scenes) == "Variant 3"
    assert list(file_names(["a/b", "a:b", "A_B", ".."]).values()) == ["a_b", "a_b 2", "A_B 3", "variant"]


def test_the_frame_that_is_shown_stays(street: Any) -> None:
    street.frame_set(13)
    variant = new()
    assert variant.frame_current == 13
    variant.frame_set(4)
    assert show(street).frame_current == 4


def test_differences_of_two_variants(street: Any) -> None:
    driving(street).location.y = 1.0
    standing(street).location.x += 1.0
    variant = new()
    driving(variant).location.y = 2.0
    press(
        bpy.ops.unisim.revert_edit, next(line for line in lines(variant) if line.object_name == standing(variant).name)
    )
    select(next(one for one in imported_objects(variant, "ACTOR") if "cone" in one.unisim.uid))
    bpy.ops.unisim.delete_actor()
    found = {one.line.uid: one for one in differences(lines(variant), lines(street))}
    changed = found[driving(street).unisim.uid]
    assert changed.here and changed.there
    assert (changed.here.what, changed.there.what) == ("Moved 2.0 m left", "Moved 1.0 m left")
    assert found[standing(street).unisim.uid].here is None
    assert found["cone-1"].there is None and found["cone-1"].line.what == "Removed"
    assert len(found) == 3


def test_variants_are_exported_into_a_folder(street: Any, tmp_path: Path) -> None:
    driving(street).location.y = 1.0
    variant = new("Left / 2")
    driving(variant).location.y = 2.0
    CASES["mesh"][0](variant)
    mute_me = next(line for line in lines(variant) if line.part == "MOVE")
    press(bpy.ops.unisim.mute_edit, mute_me)
    update()
    here, there = content(read(variant)), content(scenario_of(street, Path("/tmp/a.json")))
    assert bpy.ops.unisim.export_variants(directory=str(tmp_path / "out")) == {"FINISHED"}
    assert {path.name for path in (tmp_path / "out").glob("*.json")} == {"Scene.json", "Left _ 2.json"}
    assert content(load_scenario(tmp_path / "out" / "Scene.json")) == there
    exported = load_scenario(tmp_path / "out" / "Left _ 2.json")
    assert len(exported.edits) == len(here[0]) == 1 and exported.name == "Left / 2"
    assert exported.resolve(getattr(exported.edits[0], "mesh", "none")).is_file()


def test_nothing_is_exported_where_one_variant_cannot_be_read(street: Any, tmp_path: Path) -> None:
    variant = new("Bad")
    standing(variant).scale = (-1.0, 1.0, 1.0)
    show(street)
    with pytest.raises(RuntimeError, match="is mirrored by"):
        bpy.ops.unisim.export_variants(directory=str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_variants_are_rendered_together_and_taken_up_again(street: Any, tmp_path: Path) -> None:
    street.frame_start, street.frame_end = 4, 5
    for one in list(imported_objects(street, "CAMERA")):
        bpy.data.objects.remove(one)
    driving(street).location.y = 1.0
    street.unisim.out = str(tmp_path)
    variant = new("Second")
    driving(variant).location.y = 3.0
    new("Not marked").unisim_edits.rendered = False
    show(variant)
    assert bpy.ops.unisim.render_variants() == {"FINISHED"}
    sweeps = {name: sorted((tmp_path / name).glob("lidar/*/*.ply")) for name in ("Scene", "Second")}
    assert [len(found) for found in sweeps.values()] == [2, 2] and not (tmp_path / "Not marked").exists()
    assert sweeps["Scene"][0].read_bytes() != sweeps["Second"][0].read_bytes()
    task = background.newest[VariantsTask]
    assert isinstance(task, VariantsTask) and task.text() == "Done: 4 of 4 frames of 2 variants"
    assert load_scenario(tmp_path / "Second" / "scenario.json").name == "Second"
    kept = sweeps["Scene"][0].stat().st_mtime_ns
    sweeps["Second"][1].unlink()
    assert bpy.ops.unisim.render_variants() == {"FINISHED"}
    assert sweeps["Scene"][0].stat().st_mtime_ns == kept and sweeps["Second"][1].is_file()


def test_a_task_tells_of_the_variant_that_it_is_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, frames in (("A", 3), ("B", 1)):
        (tmp_path / name / ".state").mkdir(parents=True)
        for frame in range(frames):
            (tmp_path / name / ".state" / f"{frame:06d}.json").write_text(json.dumps({}))
    parts = [VariantRun(name, [name], tmp_path / name, set(range(3))) for name in ("A", "B")]
    task = VariantsTask(parts, tmp_path, "")
    task.at = 1
    assert task.done == 4 and task.total == 6
    assert task.measure() == "B (2 of 2): 1 of 3; 4 of 6 frames in all"
    called: list[str] = []

    def call(arguments: list[str]) -> int:
        called.extend(arguments)
        task.cancelled = True
        return 0

    monkeypatch.setattr(task, "_call", call)
    task._run()
    assert called == ["A"] and task.code == 0 and task.text().startswith("Stopped at A (1 of 2)")


def test_a_variant_that_fails_ends_the_task_with_its_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = [VariantRun(name, [name], tmp_path / name, set(range(3))) for name in ("A", "B")]
    task = VariantsTask(parts, tmp_path, "")

    def call(arguments: list[str]) -> int:
        task.words.append("Error: it does not go")
        return 1

    monkeypatch.setattr(task, "_call", call)
    task._run()
    assert task.problem == "A: it does not go"


def test_reading_a_scene_that_no_window_shows_leaves_its_frame(street: Any) -> None:
    street.frame_set(7)
    variant = new()
    driving(variant).location.y = 1.0
    show(street)
    assert np.isclose(variant.frame_current, 7)
    assert len(scenario_of(variant, Path("/tmp/a.json")).edits) == 1
    assert variant.frame_current == 7 and bpy.context.scene == street


def test_only_scenes_of_the_drive_are_variants(street: Any) -> None:
    other = bpy.data.scenes.new("Other")
    assert variants_of(street) == [street]
    other.unisim.log = street.unisim.log
    assert variants_of(street) == [street]
    with pytest.raises(UnisimError, match="is the only variant"):
        delete_variant(street)
