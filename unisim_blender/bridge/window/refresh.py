"""Everything shown made true after an operator changed keys: boxes, trajectories, images and properties."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ..objects.trajectories import trajectory_of
from .areas import areas


def refresh(changed: Iterable[bpy.types.Object]) -> None:
    """Evaluate objects again whose keys were written, and draw all windows again.

    Writing keys by `foreach_set` tells Blender nothing: without this a box stays where it was until
    another frame is shown.
    """
    for obj in changed:
        for one in (trajectory_of(obj), obj):
            if one is None:
                continue
            action = one.animation_data.action if one.animation_data is not None else None
            if action is not None:
                action.update_tag()
            one.update_tag(refresh={"OBJECT", "TIME"})
    bpy.context.view_layer.update()
    if not bpy.app.background:
        for area in areas():
            area.tag_redraw()
