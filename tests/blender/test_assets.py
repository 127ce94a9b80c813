"""Actors as assets: each with an image of itself, and insertable into another drive."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from helpers import SAMPLE, edited, read

from unisim_blender.core.scenario.edits import Insert


def test_a_library_and_an_actor_of_it(street: Any, tmp_path: Path) -> None:
    before = {o.name for o in bpy.data.objects}
    path = tmp_path / "actors.blend"
    assert bpy.ops.unisim.make_library(filepath=str(path)) == {"FINISHED"}
    assert {o.name for o in bpy.data.objects} == before
    with bpy.data.libraries.load(str(path), assets_only=True) as (there, wanted):
        assert len(there.objects) > 10
        wanted.objects = [next(name for name in there.objects if name.startswith("Car"))]
    (car,) = wanted.objects
    pixels = np.array(car.preview.image_pixels_float[:]).reshape(192, 192, 4)
    shown = pixels[..., 3] > 0.5
    assert 0.1 < shown.mean() < 0.9  # the car, and not what is round it
    assert pixels[shown][:, :3].std() > 0.05
    street.collection.objects.link(car)
    car.location = (20.0, 3.0, 0.8)
    (edit,) = read(street).edits
    assert isinstance(edit, Insert) and edit.actor == car.unisim.look
    assert edited(street).actors[edit.id].appearance.actor == car.unisim.look
    assert str(SAMPLE) in car.unisim.look_scene
