"""Readable names: stable, completed by a colour later, and never taken for a renaming or a copy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import pytest
from helpers import SAMPLE, imported, read, select

from unisim_blender.bridge.changes import following
from unisim_blender.bridge.objects.imported import apply_words, imported_objects, is_copy, original_of, source_of
from unisim_blender.core.actor_images.cache import make_images
from unisim_blender.core.actor_images.names import plain_names
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.scenario.edits import Duplicate
from unisim_blender.editing.actors.table import is_plain, names_at_import
from unisim_blender.features.actors import thumbnails


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder in which nothing is kept yet."""
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def names(scene: Any) -> dict[str, str]:
    """The names of the actors by id."""
    return {one.unisim.uid: one.name for one in imported_objects(scene, "ACTOR")}


def word(scene: Any, **words: str) -> dict[str, str]:
    """Words for colours come in."""
    by_uid = {uid.replace("_", "-"): word for uid, word in words.items()}
    return apply_words(scene, plain_names(source_of(scene).drive.actors), by_uid)


def test_an_import_names_by_class_and_number(street: Any) -> None:
    found = names(street)
    assert found["car-04"] == "Car 3" or found["car-04"].startswith("Car ")
    assert found["car-02"] == "Medium-sized Truck 1" and found["cone-3"] == "Cone 3"
    assert found == plain_names(source_of(street).drive.actors) == names_at_import(source_of(street))
    assert len(set(found.values())) == len(found) and not read(street).edits


def test_a_colour_that_comes_later_is_no_edit(street: Any) -> None:
    own = imported(street, "ACTOR", "car-04")
    before = own.name
    select(own)
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    edits = read(street).edits
    assert word(street, car_04="white", cone_1="") == {before: f"{before}, white"}
    assert own.name == own.unisim.home == copy.unisim.home == f"{before}, white" and copy.name == f"{before}.001"
    assert not is_copy(street, own) and is_copy(street, copy) and original_of(street, "ACTOR", "car-04") == own
    assert read(street).edits == edits and [edit.id for edit in edits if isinstance(edit, Duplicate)] == [copy.name]
    assert not word(street, car_04="white") and not word(street, car_04="red")  # once is enough
    assert imported(street, "ACTOR", "cone-1").name == "Cone 1"


def test_names_that_people_gave_and_those_of_old_files_stay(street: Any) -> None:
    own, old = imported(street, "ACTOR", "car-04"), imported(street, "ACTOR", "car-06")
    own.name = "The parked one"
    old.name = old.unisim.home = "Car car-06"  # as earlier versions named it
    assert not word(street, car_04="white", car_06="red")
    assert own.name == "The parked one" and old.name == "Car car-06" and not read(street).edits
    assert is_plain("Car 12", "Car 12") and is_plain("Car 12.001", "Car 12") and not is_plain("Car 12, white", "Car 12")
    assert not is_plain("Car 121", "Car 12")


def test_the_same_drive_in_two_scenes_is_named_in_both(street: Any) -> None:
    bpy.ops.scene.new(type="NEW")
    other = bpy.context.scene
    assert bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json")) == {"FINISHED"}
    second = next(one for one in imported_objects(other, "ACTOR") if one.unisim.uid == "car-04")
    assert second.name.endswith(".001") and second.name == second.unisim.home
    for scene in (street, other):
        assert len(word(scene, car_04="white")) == 1
    first = imported(street, "ACTOR", "car-04")
    assert first.name.endswith(", white") and second.name == f"{first.name}.001" == second.unisim.home
    assert not is_copy(other, second)


def test_words_that_are_kept_are_in_the_names_at_once(scene: Any, cache: Path, street_log: Path) -> None:
    made = {one.uid: one for one in make_images(open_log(street_log))}
    assert any(one.word for one in made.values()), "the street's images tell no colour"
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}
    found = names(scene)
    plain = plain_names(source_of(scene).drive.actors)
    assert found == {uid: f"{plain[uid]}, {made[uid].word}" if made[uid].word else plain[uid] for uid in plain}
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}  # again: nothing is doubled or renamed
    assert names(scene) == found and len(list(imported_objects(scene, "ACTOR"))) == len(found)


def test_a_renamed_object_is_still_followed(street: Any) -> None:
    own = next(o for o in imported_objects(street, "ACTOR") if o.parent is not None)
    before = own.name
    own.location.x += 1.0
    bpy.context.view_layer.update()
    assert (street.name, before) in following._unsettled
    renamed = apply_words(street, plain_names(source_of(street).drive.actors), {own.unisim.uid: "blue"})
    following.renamed(street, renamed)
    assert (street.name, f"{before}, blue") in following._unsettled and f"{before}, blue" in following._changed[
        street.name
    ]
    assert not any(name == before for _, name in following._unsettled)
    following.settle_now()


def test_undo_brings_no_old_name_back(street: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from unisim_blender.features.actor_list import listing

    bpy.ops.ed.undo_push(message="imported")
    log = thumbnails.log_of(street)
    monkeypatch.setitem(thumbnails._complete, log, {"car-04": "white"})
    listing.refresh_now(street)
    own = imported(street, "ACTOR", "car-04")
    name = own.name
    assert name.endswith(", white")
    own.location.x += 2.0
    bpy.ops.ed.undo_push(message="moved")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    listing.refresh_now(scene)
    assert imported(scene, "ACTOR", "car-04").name == name and not read(scene).edits
    warning = bpy.context.scene.unisim_check.warnings.add()
    warning.name = "Cone 1"
    monkeypatch.setitem(thumbnails._complete, log, {"car-04": "white", "cone-1": "orange"})
    thumbnails.name_actors()
    assert warning.name == "Cone 1, orange" == imported(scene, "ACTOR", "cone-1").name
    bpy.context.scene.unisim_check.warnings.clear()
