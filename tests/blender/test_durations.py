"""What operators say of seconds and frames."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from helpers import drawn, imported, select

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.editing.motion.braking import Approach
from unisim_blender.editing.motion.retiming import followed_briefly
from unisim_blender.editing.sampled.clock import Clock

STATUS_CHARACTERS = 72
"""About what a window of 1280 pixels shows between the hints for the mouse and Blender's version."""
CLOCK = Clock(np.arange(81.0), np.arange(81.0) / 10)


def test_operators_report_them(street: Any, capfd: Any) -> None:
    actors = source_of(street).drive.actors
    one = imported(
        street, "ACTOR", next(uid for uid, a in sorted(actors.items()) if "Car" in a.label and not a.is_moving)
    )
    select(drawn(street, [(10, 0, 0), (30, 0, 0)]), one)
    street.frame_set(2)
    assert bpy.ops.unisim.follow_curve(speed_m_s=10.0) == {"FINISHED"}
    said = capfd.readouterr().out
    assert f"Info: {one.name}: 20.0 m in 4.47 s (44.7 frames); the log ends at 1.90 s\n" in said
    select(one)
    for mode, text in (
        ("DELAY", "0.50 s (5.0 frames) later"),
        ("STOP", "stands for 0.50 s (5.0 frames)"),
        ("SPEED", "speed x0.5 from 0.20 s (frame 2) on"),
        ("STRETCH", "speed x0.5 for 4.00 s (40.0 frames)"),
    ):
        bpy.ops.unisim.retime_actor(mode=mode)
        assert f"Info: {one.name}: {text}" in capfd.readouterr().out, mode
    others = [obj for obj in street.objects if obj.unisim.kind == "ACTOR"][:3]
    select(*others)
    bpy.ops.unisim.retime_actor(mode="DELAY")
    assert "Info: 3 actors: 0.50 s (5.0 frames) later\n" in capfd.readouterr().out


def test_a_report_has_room_in_the_status_bar() -> None:
    assert len(followed_briefly(Approach(1234.5, 0.1, 2.0), 0.0, CLOCK)) <= STATUS_CHARACTERS
