"""Modules added to Blender and taken away, by names that they may have:

CLASSES       classes that are registered in this order
HANDLERS      names of lists in `bpy.app.handlers`, each with a function that is added to it
DRAWINGS      each a `Drawing`
TIMERS        functions of timers that are ended when the module is taken away
PROPERTIES    each a class of Blender's, a name, and the property that it has of that name then
MENUS         each a menu, panel or header of Blender's, and a function that is appended to it
register, unregister   for what is left to do, and for CLASSES where there are both
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
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
    for name, handler in getattr(room, "HANDLERS", ()):
        getattr(bpy.app.handlers, name).append(handler)
    for drawing in getattr(room, "DRAWINGS", ()):
        drawing.begin()
    if hasattr(room, "register"):
        room.register()
    else:
        add(getattr(room, "CLASSES", ()))
    for owner, name, value in getattr(room, "PROPERTIES", ()):
        setattr(owner, name, value)
    for menu, draw in getattr(room, "MENUS", ()):
        menu.append(draw)


def close_room(room: ModuleType) -> None:
    """Take it away again."""
    for name, handler in getattr(room, "HANDLERS", ()):
        with suppress(ValueError):  # opening a file drops handlers that are not persistent
            getattr(bpy.app.handlers, name).remove(handler)
    for drawing in getattr(room, "DRAWINGS", ()):
        drawing.end()
    for timer in getattr(room, "TIMERS", ()):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    for menu, draw in getattr(room, "MENUS", ()):
        menu.remove(draw)
    for owner, name, _ in getattr(room, "PROPERTIES", ()):
        delattr(owner, name)
    if hasattr(room, "unregister"):
        room.unregister()
    else:
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
