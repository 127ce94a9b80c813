"""What operators say of seconds and frames."""

from __future__ import annotations

from typing import Any

import bpy
from helpers import drawn, select, thing

from unisim_blender.bridge.objects.source import source_of


def test_operators_report_them(street: Any, capfd: Any) -> None:
    actors = source_of(street).drive.actors
    one = thing(street, "ACTOR", next(uid for uid, a in sorted(actors.items()) if "Car" in a.label and not a.is_moving))
    select(drawn(street, [(10, 0, 0), (30, 0, 0)]), one)
    street.frame_set(2)
    assert bpy.ops.unisim.follow_curve(speed_m_s=10.0) == {"FINISHED"}
    said = capfd.readouterr().out
    assert "20.0 m take 2.00 s (20.0 frames); From 0.20 s (frame 2.0) to 2.20 s (frame 22.0); The log ends at 1.90 s" in said
    select(one)
    for way, text in (
        ("DELAY", "0.50 s (5.0 frames) later"),
        ("STOP", "Stands for 0.50 s (5.0 frames)"),
        ("SPEED", "What takes 1 s takes 2.00 s (20.0 frames)"),
        ("STRETCH", "become 4.00 s (40.0 frames)"),
    ):
        bpy.ops.unisim.retime_actor(way=way)
        assert text in capfd.readouterr().out, way
