"""Actors of another class, rows of cones and parked rows: where they stand, and that they are plausible at once."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest
from helpers import driving_car, edited, read

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.actor_images.names import group_of
from unisim_blender.core.scenario.edits import Swap
from unisim_blender.editing.motion.kinematics import motion_of
from unisim_blender.editing.motion.plausibility import warnings_of
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.features.actors.appearances import slow_down


def warned(scene: Any) -> list[str]:
    """What Check Edits says."""
    drive = source_of(scene).drive
    return [f"{found.name} {found.text}" for found in warnings_of(sample_all(scene, Clock.of(drive)), drive)]


def test_a_swapped_car_is_the_most_similar_of_its_new_class_on_the_same_ground(street: Any) -> None:
    drive = source_of(street).drive
    one = driving_car(street)
    before = drive.actors[one.unisim.uid]
    assert bpy.ops.unisim.swap_class(group="TRUCK") == {"FINISHED"}
    (swap,) = read(street).edits
    assert isinstance(swap, Swap) and swap.actor == before.uid
    trucks = [uid for uid, actor in drive.actors.items() if group_of(actor.label) == "TRUCK"]
    assert swap.appearance == min(trucks, key=lambda uid: np.linalg.norm(drive.actors[uid].size_m - before.size_m))
    now = edited(street).actors[before.uid]
    for time_s in sorted(drive.time_s.values()):
        low, high = (a.world_from_actor.at(time_s)[2, 3] - a.size_m[2] / 2 for a in (now, before))
        assert low == pytest.approx(high, abs=1e-4)
    assert warned(street) == []
    with pytest.raises(RuntimeError, match="there are no People here"):
        bpy.ops.unisim.swap_class(group="PERSON")


def test_who_is_slowed_down_walks_the_same_path(street: Any) -> None:
    one, clock = driving_car(street), Clock.of(source_of(street).drive)
    actor = source_of(street).drive.actors[one.unisim.uid]
    slow_down(one, 1.4, clock)
    now = edited(street).actors[actor.uid].world_from_actor.at(clock.times_s)[:, :3, 3]
    speeds = motion_of(now, clock.times_s).speed_m_s
    assert speeds.max() == pytest.approx(1.4, abs=0.02)
    start = actor.world_from_actor.at(clock.times_s[:1])[0, :3, 3]
    assert now[0] == pytest.approx(start, abs=0.02)
    slow_down(one, 20.0, clock)
    again = edited(street).actors[actor.uid].world_from_actor.at(clock.times_s)[:, :3, 3]
    assert again == pytest.approx(now, abs=1e-6), "what is slow enough stays"
