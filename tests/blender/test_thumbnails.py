"""Thumbnails of actors: made beside Blender, kept, shown as icons, and chosen from."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import SAMPLE, edited, imported, read, select

from unisim_blender.core.actor_images.cache import cached_images
from unisim_blender.core.scenario.edits import Insert, Swap
from unisim_blender.editing.actors.portraits import Portrait, portrait_path, save_portrait, saved_portrait
from unisim_blender.features.actors import appearances as actor_choice
from unisim_blender.features.actors import thumbnails
from unisim_blender.features.actors.panel import portrait
from unisim_blender.process.client import client


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder in which nothing is kept yet."""
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    for known in (
        thumbnails._known,
        thumbnails._complete,
        thumbnails._problems,
        thumbnails._portraits,
        thumbnails._plain,
    ):
        known.clear()
    thumbnails._wanted.clear()
    return tmp_path / "cache"


def ended(maker: thumbnails.ThumbnailMaker) -> None:
    """Wait for a process's end."""
    last = time.monotonic() + 240
    while not maker.ended:
        assert time.monotonic() < last
        time.sleep(0.05)


def made(path: Path) -> None:
    """Have a log's thumbnails made, as a window does."""
    thumbnails._makers[path] = maker = thumbnails.ThumbnailMaker(path, "")
    maker.start()
    ended(maker)
    assert maker.code == 0, list(maker.words)
    assert thumbnails._look() is None


def test_a_process_makes_them_and_they_are_kept(scene: Any, street_log: Path) -> None:
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}
    log = thumbnails.log_of(scene)
    first = next(o for o in scene.objects if o.unisim.kind == "ACTOR").unisim.uid
    assert thumbnails.icon_of(log, first) == thumbnails.grey() and "grey" in thumbnails._collection()
    made(log)
    found = thumbnails.images_of(log)
    assert (
        set(found) == {o.unisim.uid for o in scene.objects if o.unisim.kind == "ACTOR"} and cached_images(log) == found
    )
    seen = next(uid for uid, one in found.items() if one.image)
    assert str(found[seen].image) not in thumbnails._collection()
    thumbnails.icon_of(log, seen)
    preview = thumbnails._collection()[str(found[seen].image)]
    pixels = np.array(preview.image_pixels_float[:]).reshape(-1, 4)
    assert len(pixels) > 100 and pixels[:, :3].std() > 0.02
    words = {uid: one.word for uid, one in found.items()}
    named = [o for o in scene.objects if o.unisim.kind == "ACTOR" and words[o.unisim.uid]]
    assert named and all(o.name.endswith(f", {words[o.unisim.uid]}") and o.name == o.unisim.home for o in named)
    assert not read(scene).edits


def test_what_is_kept_needs_no_process(scene: Any, street_log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made(street_log)
    thumbnails._known.clear()
    thumbnails._complete.clear()

    def refused(*_: Any) -> None:
        raise AssertionError("a process was started")

    monkeypatch.setattr(thumbnails.ThumbnailMaker, "start", refused)
    thumbnails.ask(street_log)
    assert thumbnails._complete[street_log] and thumbnails.images_of(street_log)


def test_a_log_that_cannot_be_read_is_tried_once(addon: Any, tmp_path: Path) -> None:
    path = tmp_path / "empty"
    path.mkdir()
    thumbnails._makers[path] = maker = thumbnails.ThumbnailMaker(path, "")
    maker.start()
    ended(maker)
    assert maker.code != 0 and thumbnails._look() is None
    assert thumbnails._problems[path] and path not in thumbnails._makers
    thumbnails.ask(path)
    assert path not in thumbnails._makers
    thumbnails.try_again()
    assert not thumbnails._problems


def test_a_stopped_process_ends(addon: Any, street_log: Path) -> None:
    maker = thumbnails.ThumbnailMaker(street_log, "")
    maker.start()
    maker.stop()
    ended(maker)
    assert maker.process is None or maker.process.poll() is not None
    if maker.process is not None:
        with pytest.raises(OSError):
            os.kill(maker.process.pid, 0)


def test_without_the_log_the_worker_renders_it(street: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene_path, nowhere = SAMPLE / "scene", Path("/nowhere/log")
    assert thumbnails.icon_of(nowhere, "car-03", scene_path) == thumbnails.grey()
    assert list(thumbnails._wanted) == [(scene_path, "car-03")]
    last = time.monotonic() + 240
    thumbnails._render()
    while thumbnails._rendering:
        assert time.monotonic() < last
        time.sleep(0.1)
        thumbnails._render()
    kept = saved_portrait(scene_path, "car-03")
    assert kept is not None
    thumbnails.icon_of(nowhere, "car-03", scene_path)
    preview = thumbnails._collection()[str(kept)]
    assert np.array(preview.image_pixels_float[:]).reshape(-1, 4)[:, :3].std() > 0.05
    thumbnails._portraits.clear()
    thumbnails.icon_of(nowhere, "car-03", scene_path)
    assert thumbnails._render() and not thumbnails._rendering  # the second time it is read from disk
    thumbnails.icon_of(nowhere, "nobody", scene_path)
    assert not thumbnails._render() and not thumbnails._rendering and not thumbnails._wanted


def test_a_portrait_that_fails_is_none(addon: Any, tmp_path: Path) -> None:
    request = client("").ask("nonsense")
    one = Portrait(SAMPLE / "scene", "car-03", request)
    last = time.monotonic() + 120
    while not one.ended:
        assert time.monotonic() < last
        one.take(client(""))
        time.sleep(0.05)
    assert one.pixels is None
    path = save_portrait(tmp_path, "a/b: c", np.zeros((4, 4, 3), np.uint8))
    assert path == portrait_path(tmp_path, "a/b: c") == saved_portrait(tmp_path, "a/b: c") and path.parent.is_dir()


def test_the_same_class_is_offered_first_with_names_and_sizes(street: Any) -> None:
    choice = actor_choice.choice_of(bpy.context, "")
    cars = actor_choice.listed(choice, "CAR")
    items = actor_choice.items_of(bpy.context, "", "CAR", 1)
    assert [item[0] for item in items] == cars and len({item[4] for item in items}) == len(items)
    names = [item[1] for item in items]
    assert names == [choice.names[uid] for uid in cars] and names.index("Car 2") < names.index("Car 10")
    assert " m" in items[0][2] and items[0][3] == thumbnails.icon_of(choice.log_path, cars[0], choice.scene_path)
    assert {item[0] for item in actor_choice.items_of(bpy.context, "", "ALL", 0)} == set(choice.actors)
    assert actor_choice.items_of(bpy.context, "", "PERSON", 1) == actor_choice.NONE
    numbers = {item[0]: item[4] for item in actor_choice.items_of(bpy.context, "", "ALL", 0)}
    assert all(numbers[item[0]] == item[4] for item in items)  # whatever the filter


def test_pages_hold_what_fits(street: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(actor_choice, "PAGE", 6)
    assert actor_choice.pages(bpy.context, "", "CAR") == 3
    pages = [[item[0] for item in actor_choice.items_of(bpy.context, "", "CAR", page)] for page in (1, 2, 3)]
    assert [len(page) for page in pages] == [6, 6, 2]
    assert sum(pages, []) == actor_choice.listed(actor_choice.choice_of(bpy.context, ""), "CAR")


def test_an_actor_of_the_drive_is_inserted_and_replaced(street: Any) -> None:
    street.cursor.location = (20.0, 3.0, 0.0)
    assert bpy.ops.unisim.insert_actor(appearance="car-03") == {"FINISHED"}
    new = bpy.context.active_object
    (edit,) = read(street).edits
    assert isinstance(edit, Insert) and edit.actor == "car-03" and edit.scene is None
    assert edited(street).actors[edit.id].appearance.actor == "car-03" and edit.id == new.name
    select(imported(street, "ACTOR", "car-04"))
    assert bpy.ops.unisim.replace_appearance(appearance="car-12") == {"FINISHED"}
    swap = next(edit for edit in read(street).edits if isinstance(edit, Swap))
    assert swap.actor == "car-04" and swap.appearance == "car-12"


def test_no_choice_and_another_scenes_actor(street: Any) -> None:
    select(imported(street, "ACTOR", "car-04"))
    with pytest.raises(RuntimeError, match="choose an actor by its thumbnail"):
        bpy.ops.unisim.replace_appearance()
    with pytest.raises(RuntimeError, match='has no actor "nobody"'):
        bpy.ops.unisim.insert_actor(actor="nobody")
    with pytest.raises(RuntimeError, match="nowhere"):
        bpy.ops.unisim.insert_actor(filepath="/nowhere/scene.json")
    assert not read(street).edits
    assert bpy.ops.unisim.insert_actor(filepath=str(SAMPLE / "scene" / "scene.json")) == {"FINISHED"}
    (edit,) = read(street).edits
    assert isinstance(edit, Insert) and edit.actor == "car-01"  # the first car by name


def test_the_card_has_the_image_of_what_is_shown(street: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Any, ...]] = []

    def icon_of(*arguments: Any) -> int:
        asked.append(arguments)
        return 7

    monkeypatch.setattr(thumbnails, "icon_of", icon_of)
    select(imported(street, "ACTOR", "car-04"))
    assert portrait(bpy.context) == 7 and asked[-1][1] == "car-04"
    bpy.ops.unisim.replace_appearance(appearance="car-12")
    assert portrait(bpy.context) == 7 and asked[-1][1] == "car-12"
    bpy.context.active_object.unisim.look_scene = str(SAMPLE / "scene")
    portrait(bpy.context)
    assert asked[-1][2] == SAMPLE / "scene"
    bpy.context.active_object.unisim.mesh = True
    monkeypatch.setattr(thumbnails, "grey", lambda: 3)
    assert portrait(bpy.context) == 3
