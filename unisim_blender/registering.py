"""Modules added to Blender and taken away: those with CLASSES or DRAWINGS, and those with functions `register` and
`unregister` of their own where there is more to do."""

from collections.abc import Callable, Iterable
from types import ModuleType
from typing import Any

import bpy


def add(classes: Iterable[type]) -> None:
    """Register classes in order."""
    for cls in classes:
        bpy.utils.register_class(cls)


def take_away(classes: Iterable[type]) -> None:
    """Unregister classes in the opposite order."""
    for cls in reversed(list(classes)):
        bpy.utils.unregister_class(cls)


def open_room(room: ModuleType) -> None:
    """Add what a module has for Blender."""
    if hasattr(room, "register"):
        room.register()
    else:
        add(getattr(room, "CLASSES", ()))
        for drawing in getattr(room, "DRAWINGS", ()):
            drawing.begin()


def close_room(room: ModuleType) -> None:
    """Take it away again."""
    if hasattr(room, "unregister"):
        room.unregister()
    else:
        for drawing in getattr(room, "DRAWINGS", ()):
            drawing.end()
        take_away(getattr(room, "CLASSES", ()))


class Drawing:
    """A function that draws into the 3D view whenever that is drawn, from `begin` to `end`: in the world's coordinates,
    or with ``when`` "POST_PIXEL" in the region's pixels."""

    def __init__(self, draw: Callable[[], None], when: str = "POST_VIEW") -> None:
        self.draw, self.when = draw, when
        self.handle: Any = None

    def begin(self) -> None:
        """Draw from now on; without a window there is nothing to draw in."""
        if not bpy.app.background:
            self.handle = bpy.types.SpaceView3D.draw_handler_add(self.draw, (), "WINDOW", self.when)

    def end(self) -> None:
        """Draw no more."""
        if self.handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self.handle, "WINDOW")
            self.handle = None
