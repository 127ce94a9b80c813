"""Rooms into Blender and out of it: modules with CLASSES, and with functions of their own where there is more to do."""

from collections.abc import Iterable
from types import ModuleType

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
        add(room.CLASSES)


def close_room(room: ModuleType) -> None:
    """Take it away again."""
    if hasattr(room, "unregister"):
        room.unregister()
    else:
        take_away(room.CLASSES)
