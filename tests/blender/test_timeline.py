"""The presence timeline: where rows and bars lie, and what a click hits."""

from __future__ import annotations

from typing import Any

import bpy

from unisim_blender.features.actor_list import listing, timeline


def test_going_to_a_time_shows_the_nearest_frame(street: Any) -> None:
    listing.refresh_now(street)
    timeline.go_to(bpy.context, 1.24)
    assert street.frame_current == 12
    assert not timeline.shown(bpy.context)  # there is no 3D view here
