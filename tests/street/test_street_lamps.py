"""Streets with lamps that change: part of the recipe, lit as their times say, each row at its own."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from unisim_blender.core.errors import LogError
from unisim_blender.core.world.lamps import ActorLamp
from unisim_street.street import build_street, recipe_document
from unisim_street.truth import truth_camera

SIZE: dict[str, Any] = {"seed": 3, "frames": 20, "width": 240, "height": 135}


def test_lamps_are_part_of_the_recipe_and_change_nothing_else() -> None:
    plain, lamps = build_street(**SIZE), build_street(**SIZE, lamps=True)
    assert "lamps" not in json.dumps(recipe_document(plain.recipe)) and recipe_document(lamps.recipe)["lamps"] is True
    assert set(lamps.drive.actors) - set(plain.drive.actors) == {"traffic-light"}
    assert {uid for uid, asset in plain.assets.items() if len(asset.parts) != len(lamps.assets[uid].parts)} == {
        "car-01"
    }
    with pytest.raises(LogError, match="exact engine alone"):
        build_street(**SIZE, lamps=True, engine="cycles")
    with pytest.raises(LogError, match="lamps is true or false"):
        build_street(**SIZE, lamps=1)  # type: ignore[arg-type]


def test_an_actors_lamps_are_lit_as_it_has_them() -> None:
    street = build_street(**SIZE, lamps=True)
    recorded = truth_camera(street, street.drive, "front_camera", 4).rgb
    light = street.drive.actors["traffic-light"]
    lamp = ActorLamp("red-green", ("green", "red"), np.zeros(1), np.zeros(1, np.int64), ())
    drive = replace(street.drive, actors={**street.drive.actors, light.uid: replace(light, lamps=(lamp,))})
    edited = truth_camera(street, drive, "front_camera", 4).rgb
    change = (edited - recorded)[(edited != recorded).any(-1)]
    assert 4 < len(change) < 200
    assert change[:, 0].min() < -0.3 and change[:, 1].max() > 0.2  # red goes out, green is lit
