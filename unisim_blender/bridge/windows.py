"""The areas of Blender's windows."""

from __future__ import annotations

from collections.abc import Iterator

import bpy


def areas(*kinds: str) -> Iterator[bpy.types.Area]:
    """Every area of some kinds, in every window; of any kind without."""
    for window in bpy.context.window_manager.windows:
        yield from (area for area in window.screen.areas if not kinds or area.type in kinds)
