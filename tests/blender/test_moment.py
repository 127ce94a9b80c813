"""The scene about one frame: as stepping would find it, and what of a picture an edit touches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import thing
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.bridge.cameras import model_of
from unisim_blender.bridge.clock import Clock
from unisim_blender.bridge.neighbours import sample_now
from unisim_blender.bridge.poses import same
from unisim_blender.bridge.sampling import kept_frame, picture_size, sample
from unisim_blender.bridge.snapshot import sized
from unisim_blender.bridge.source import source_of
from unisim_blender.bridge.touched import touched


def both(scene: Any, frame: int) -> tuple[Any, Any]:
    """The things about a frame, without leaving it and by stepping."""
    clock = Clock.of(source_of(scene).drive).around(frame)
    scene.frame_set(frame)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    now = sample_now(scene, depsgraph, clock)
    with kept_frame(scene):
        stepped = sample(scene, depsgraph, clock, scene.frame_set)
    return now, stepped


@pytest.mark.parametrize("frame", [0, 7, 19])
def test_the_moment_is_what_stepping_finds(street: Any, frame: int) -> None:
    empty = bpy.data.objects.new("parent", None)
    street.collection.objects.link(empty)
    child = next(o for o in street.objects if o.unisim.kind == "ACTOR" and o.animation_data is not None)
    child.parent = empty
    empty.location = (1.0, 2.0, 0.0)
    now, stepped = both(street, frame)
    assert [t.name for t in now.things] == [t.name for t in stepped.things]
    for a, b in zip(now.things, stepped.things, strict=True):
        assert same(a.poses, b.poses).all(), a.name
        assert (a.there == b.there).all(), a.name


def picture(scene: Any, path: Path) -> NDArray[Any]:
    """F12's bytes."""
    scene.render.filepath = str(path)
    scene.render.image_settings.file_format = "PNG"
    bpy.ops.render.render(write_still=True)
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def test_what_an_edit_touches_holds_all_that_it_changes(street: Any, tmp_path: Path) -> None:
    frame = 9
    street.render.engine, street.render.resolution_percentage = "UNISIM", 50
    street.frame_set(frame)
    before, _ = both(street, frame)
    first = picture(street, tmp_path / "a.png")
    drive = source_of(street).drive
    camera = np.array(street.camera.matrix_world.translation)
    standing = [a for a in drive.actors.values() if not a.is_moving and 8 < a.world_from_actor.positions[0, 0] - camera[0] < 30]
    one = thing(street, "ACTOR", standing[0].uid)
    one.location.y += 1.0
    bpy.context.view_layer.update()
    after, _ = both(street, frame)
    second = picture(street, tmp_path / "b.png")
    view = next(t for t in after.things if t.name == street.camera.name)
    model = sized(model_of(street.camera), picture_size(street.render), 1.0, True)
    rectangle = touched(before, after, view, model)
    assert rectangle is not None
    left, top, right, bottom = rectangle
    changed = np.abs(first - second).max(-1) > 1
    assert changed.any()
    changed[top:bottom, left:right] = False
    assert not changed.any()
    assert (right - left) * (bottom - top) < first.shape[0] * first.shape[1]
    assert touched(before, before, view, model) == (model.width, model.height, 0, 0)
