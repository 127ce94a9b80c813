"""What the sidebar says of actors, and that its panels name what Blender has."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import SAMPLE, imported, select

from unisim_blender import features
from unisim_blender.bridge.objects.imported import imported_objects, is_copy, source_of
from unisim_blender.bridge.views.actors import card_of
from unisim_blender.bridge.views.trails import trail
from unisim_blender.editing.sampled.clock import Clock


def test_a_card_has_the_logs_figures(street: Any) -> None:
    drive = source_of(street).drive
    street.frame_set(10)
    now = drive.time_s[10]
    for uid, actor in drive.actors.items():
        if not actor.start_s + 0.2 < now < actor.end_s - 0.2:
            continue
        card = card_of(street, imported(street, "ACTOR", uid), drive)
        trajectory = actor.world_from_actor
        speed = (
            np.linalg.norm(trajectory.at(now + 0.1)[:3, 3] - trajectory.at(now - 0.1)[:3, 3]) / 0.2
            if actor.is_moving
            else 0.0
        )
        assert (
            card.speed_m_s == pytest.approx(speed, abs=0.05) and card.label == actor.label and card.role == "recorded"
        )
        apart = np.linalg.norm(trajectory.at(now)[:3, 3] - drive.world_from_ego.at(now)[:3, 3])
        assert card.distance_m == pytest.approx(apart, abs=0.3)
        times = [t for t in sorted(drive.time_s.values()) if actor.start_s <= t <= actor.end_s]
        assert card.present_s == pytest.approx((times[0], times[-1]), abs=1e-6)


def test_a_renamed_actor_is_no_copy_and_keeps_its_recorded_outline(street: Any) -> None:
    drive = source_of(street).drive
    one = next(o for o in imported_objects(street, "ACTOR") if o.parent is None)
    one.name = "White car"
    one.location.x += 2.0
    bpy.context.view_layer.update()
    assert not is_copy(street, one) and card_of(street, one, drive).role == "recorded"
    assert len(trail(one, drive, Clock.of(drive), 0.0).points)
    select(one)
    bpy.ops.object.duplicate()
    copies = [is_copy(street, o) for o in imported_objects(street, "ACTOR") if o.unisim.uid == one.unisim.uid]
    assert sorted(copies) == [False, True]


def test_an_appearance_of_another_scene_leaves_an_actor_a_recorded_one(street: Any) -> None:
    drive = source_of(street).drive
    one = next(o for o in imported_objects(street, "ACTOR") if o.parent is None)
    one.unisim.look, one.unisim.look_scene = "car-13", str(SAMPLE / "scene")
    assert card_of(street, one, drive).role == "recorded, other appearance"
    assert bpy.ops.unisim.insert_actor(filepath=one.unisim.look_scene, actor=one.unisim.uid) == {"FINISHED"}
    assert card_of(street, bpy.context.active_object, drive).role == "inserted"


def test_an_added_sensor_is_no_copy(street: Any) -> None:
    bpy.ops.unisim.add_camera()
    assert not is_copy(street, bpy.context.active_object)


def test_panels_name_icons_operators_and_properties_that_there_are(scene: Any) -> None:
    icons = set(bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items.keys())
    files = list(Path(features.__file__).parent.rglob("*.py"))
    text = "".join(path.read_text() for path in files)
    assert len(files) > 30
    assert set(re.findall(r'icon="(\w+)"', text)) <= icons
    for name in re.findall(r'"unisim\.(\w+)"', text):
        assert hasattr(bpy.types, f"UNISIM_OT_{name}"), name
    for name in re.findall(r'prop\((?:about|context\.scene\.unisim), "(\w+)"', text):
        groups = scene.unisim, scene.unisim_simulation, scene.unisim_batch, scene.unisim_tracks
        settings = [group.bl_rna for group in groups]
        assert any(name in one.properties for one in settings), name
