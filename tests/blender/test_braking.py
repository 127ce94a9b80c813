"""Operators that let actors brake: at the speed and deceleration of their class, from the time of the edit."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest
from helpers import drawn, driving_car, imported, select

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.geometry import FloatArray
from unisim_blender.editing.motion.plausibility import warnings_of
from unisim_blender.editing.sampled.clock import Clock


def places(scene: Any, obj: Any) -> FloatArray:
    """Where an object is at each frame (N, 3)."""
    sampled = sample_all(scene, Clock.of(source_of(scene).drive))
    return next(one.poses[:, :3, 3] for one in sampled.of("ACTOR") if one.name == obj.name)


def newest() -> Any:
    """Settings of the operator that the redo panel shows."""
    return bpy.context.window_manager.operators[-1].properties


def test_a_pedestrian_walks_and_stops_at_the_curves_end(street: Any) -> None:
    drive = source_of(street).drive
    one = imported(street, "ACTOR", next(u for u, a in sorted(drive.actors.items()) if not a.is_moving))
    one.unisim.label = "Pedestrian"
    select(drawn(street, [(10, 0, 0), (11, 0, 0)]), one)
    street.frame_set(1)
    assert bpy.ops.unisim.follow_curve("EXEC_DEFAULT", True) == {"FINISHED"}
    assert newest().speed_m_s == pytest.approx(1.4)
    found = places(street, one)
    assert np.linalg.norm(np.diff(found, axis=0), axis=1).max() < 0.15
    street.frame_set(40)
    bpy.context.view_layer.update()
    assert tuple(one.matrix_world.translation)[:2] == pytest.approx((11.0, 0.0), abs=1e-4)


@pytest.mark.parametrize("mode", ["STOP", "SPEED", "STRETCH"])
@pytest.mark.parametrize("braking", ["COMFORTABLE", "EMERGENCY"])
def test_other_speeds_pass_the_check(street: Any, braking: str, mode: str) -> None:
    one, drive = driving_car(street), source_of(street).drive
    street.frame_set(3)
    before = places(street, one)
    assert bpy.ops.unisim.retime_actor(mode=mode, braking=braking) == {"FINISHED"}
    found = warnings_of(sample_all(street, Clock.of(drive)), drive)
    assert [w.text for w in found if w.name == one.name and "m/s²" in w.text] == []
    now = places(street, one)
    assert now[:4] == pytest.approx(before[:4], abs=1e-4), "as before until it brakes"
    assert np.linalg.norm(now[-1] - before[-1]) > 0.5


def test_a_given_deceleration(street: Any) -> None:
    one = driving_car(street)
    bpy.ops.unisim.retime_actor(mode="STOP", braking="CUSTOM", deceleration_m_s2=4.0)
    times = Clock.of(source_of(street).drive).times_s
    speed = np.linalg.norm(np.diff(places(street, one), axis=0), axis=1) / np.diff(times)
    slower = -np.diff(speed)[5:9] / np.diff(times)[6:10]
    assert slower == pytest.approx(np.full(4, 4.0), abs=0.3)


def test_the_redo_panel_has_the_times_of_the_edit(street: Any) -> None:
    one = driving_car(street)
    line = drawn(street, [(10, 0, 0), (30, 0, 0)])
    clock = Clock.of(source_of(street).drive)
    for operator, settings in ((bpy.ops.unisim.retime_actor, {"mode": "SPEED"}), (bpy.ops.unisim.follow_curve, {})):
        select(line, one)
        street.frame_set(4)
        operator("EXEC_DEFAULT", True, **settings)
        street.frame_set(9)
        assert newest().first_s == pytest.approx(float(clock.time_s(np.array(4))))
    moved = places(street, one)
    assert bpy.ops.unisim.follow_curve(first_s=newest().first_s) == {"FINISHED"}
    assert places(street, one) == pytest.approx(moved, abs=1e-4), "done again at another frame, it is the same"
