"""Lamps of streets whose truth is known: which change, when, and that nothing else is taken for one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from written_street import write_recipe

from unisim_blender.core.actor_images import lamps as searched
from unisim_blender.core.actor_images.lamps import lamps_in
from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.json_file import Node
from unisim_blender.core.world.lamps import ActorLamp
from unisim_street.paint.materials import Bulb
from unisim_street.street import load_street

SIZE: dict[str, Any] = {"frames": 20, "width": 480, "height": 270}


@pytest.fixture(scope="module")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_recipe(tmp_path_factory.mktemp("lamps") / "log", seed=0, lamps=True, **SIZE)


def test_what_changes_is_recognised_at_every_image(log_path: Path) -> None:
    log, street = open_log(log_path), load_street(log_path)
    by_actor = lamps_in(log)
    assert {uid: sorted(lamp.name for lamp in lamps) for uid, lamps in by_actor.items()} == {
        "car-01": ["amber left", "red"],
        "traffic-light": ["red-green"],
    }
    camera = log.drive.cameras["front_camera"]
    for uid, lamps in by_actor.items():
        bulbs = {p.material.name: p.material for p in street.assets[uid].parts if isinstance(p.material, Bulb)}
        for lamp in lamps:
            for time_s in camera.time_s.values():
                (state,) = lamp.at(time_s).shown
                bulb = bulbs["red" if lamp.name == "red-green" else lamp.name]
                rows = np.searchsorted(bulb.times_s, [time_s - 0.03, time_s + 0.03], "right") - 1
                if rows[0] != rows[1]:
                    continue  # the image is exposed while it changes
                lit = bulb.lit[max(rows[0], 0)]
                assert (lamp.states[state] in ("red", "on")) == lit, (uid, lamp.name, time_s)
            assert lamp.certainty > 0.95


def test_a_street_without_lamps_that_change_has_none(tmp_path: Path) -> None:
    assert lamps_in(open_log(write_recipe(tmp_path / "log", seed=0, **SIZE))) == {}


def test_they_are_searched_once(log_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = open_log(log_path)
    first = lamps_in(log)
    monkeypatch.setattr(searched, "_Box", lambda *_: pytest.fail("searched again"))
    assert lamps_in(log) == first
    lamp = first["traffic-light"][0]
    with pytest.raises(LogError, match="is no lamp"):
        ActorLamp.from_json(Node({**lamp.to_json(), "shown": [2] * len(lamp.shown)}, "here", LogError))
