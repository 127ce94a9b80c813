"""Warnings: none for what was recorded, one for each implausible edit."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from helpers import imported, select

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.editing.motion.plausibility import on_actors, shadow_note, warnings_of
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.texts import Text, unpacked


def warned(scene: Any) -> dict[str, str]:
    """The warnings' texts by object."""
    drive = source_of(scene).drive
    return {found.name: found.text for found in warnings_of(sample_all(scene, Clock.of(drive)), drive)}


def all_warned(scene: Any) -> dict[str, str]:
    """All of each object's warnings in one text."""
    drive = source_of(scene).drive
    out: dict[str, str] = {}
    for found in warnings_of(sample_all(scene, Clock.of(drive)), drive):
        out[found.name] = f"{out.get(found.name, '')}{found.text}; "
    return out


def first(scene: Any, moving: bool) -> Any:
    """The object of an actor that drives, or stands."""
    drive = source_of(scene).drive
    return imported(
        scene, "ACTOR", next(u for u, a in sorted(drive.actors.items()) if a.is_moving == moving and "Car" in a.label)
    )


def test_nothing_recorded_is_odd(street: Any) -> None:
    assert warned(street) == {}


def test_a_copy_in_place_overlaps(street: Any) -> None:
    select(first(street, moving=False))
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    assert "overlaps" in " ".join(warned(street).values()) and copy is not None


def test_what_becomes_of_recorded_shadows_is_told(street: Any) -> None:
    check = street.unisim_check
    bpy.ops.unisim.check()
    assert check.shadows.text == ""
    one = first(street, moving=False)
    one.location.y += 3.0
    bpy.ops.unisim.check()
    told = unpacked(check.shadows.text_parts, check.shadows.text)
    assert isinstance(told, Text)
    assert told.startswith("Recorded shadows stay") and told.endswith(f"under the actor: {one.name}")
    drive = source_of(street).drive
    untrained = shadow_note(sample_all(street, Clock.of(drive)), drive, False)
    assert untrained == f"Recorded shadows stay where they were: {one.name}"
    street.unisim_sun.enabled = True
    assert shadow_note(sample_all(street, Clock.of(drive)), drive, True) == ""


def test_a_flying_car(street: Any) -> None:
    one = first(street, moving=False)
    one.location.z += 2.0
    assert "2.0 m above the ground" in warned(street)[one.name]


def test_a_car_that_drives_sideways_and_one_that_is_too_fast(street: Any) -> None:
    drive = source_of(street).drive
    positions = {uid: actor.world_from_actor.positions for uid, actor in drive.actors.items() if actor.is_moving}
    fastest = max(positions, key=lambda uid: float(np.linalg.norm(positions[uid][-1] - positions[uid][0])))
    one = imported(street, "ACTOR", fastest)
    one.delta_rotation_quaternion = (np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4))
    assert "sideways" in all_warned(street)[one.name]
    one.delta_rotation_quaternion = (1, 0, 0, 0)
    select(one)
    street.frame_set(0)
    bpy.ops.unisim.retime_actor(mode="SPEED", speed=20.0, braking="CUSTOM", deceleration_m_s2=1e3)
    assert "km/h" in all_warned(street)[one.name]


def test_a_view_from_far_away(street: Any) -> None:
    street.camera.delta_location = (0.0, 0.0, 8.0)
    assert "8." in warned(street)[street.camera.name]


def test_the_list_jumps_to_the_place(street: Any) -> None:
    one = first(street, moving=False)
    one.location.z += 2.0
    assert bpy.ops.unisim.check() == {"FINISHED"}
    (item,) = street.unisim_check.warnings
    assert bpy.ops.unisim.go_to(object_name=item.name, frame=item.frame) == {"FINISHED"}
    assert bpy.context.active_object == one and street.frame_current == item.frame


def test_returns_of_an_actor_are_no_ground(street: Any) -> None:
    drive = source_of(street).drive
    frame = drive.frames[0]
    actor = next(a for a in drive.actors.values() if not a.is_moving)
    pose = actor.world_from_actor.at(drive.time_s[frame])
    body = pose[:3, 3] + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, actor.size_m[2] / 2]])
    far = pose[:3, 3] + np.array([[0.0, 0.0, 10.0]])
    assert on_actors(drive, np.concatenate([body, far]), frame).tolist() == [True, True, False]
