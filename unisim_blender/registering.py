"""Modules added to Blender and taken away. Their classes of Blender's are registered in the order of their definitions, and
so are other things, by names that they may have:

HANDLERS      names of lists in `bpy.app.handlers`, each with a function that is added to it
DRAWINGS      each a `Drawing`
TIMERS        functions of timers that are ended when the module is taken away
PROPERTIES    each a class of Blender's, a name, and the property that it has of that name then
MENUS         each a menu, panel or header of Blender's, and a function that is appended to it
SHORTCUTS     each a `Shortcut`
register, unregister   for what is done before all that, and after it is taken away
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from types import ModuleType
from typing import Any, NamedTuple

import bpy


class Shortcut(NamedTuple):
    """A key that calls an operator with ``properties``, in a keymap of the window or of an editor."""

    operator: str
    key: str
    modifiers: tuple[str, ...] = ()
    properties: dict[str, object] = {}
    keymap: str = "Object Mode"
    editor: str = "EMPTY"


_keys: dict[str, list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]]] = {}


def keys_of(module: str) -> list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]]:
    """Return the shortcuts of a module, as Blender has them, each with its keymap."""
    return _keys.get(module, [])


def classes_of(room: ModuleType) -> list[Any]:
    """Return the classes of Blender's that a module defines, in their order."""
    return [
        cls
        for cls in vars(room).values()
        if isinstance(cls, type) and issubclass(cls, bpy.types.bpy_struct) and cls.__module__ == room.__name__
    ]


def open_room(room: ModuleType) -> None:
    """Add what a module has for Blender. Operators are called as their classes: UNISIM_OT_check is `unisim.check`."""
    if hasattr(room, "register"):
        room.register()
    for name, handler in getattr(room, "HANDLERS", ()):
        getattr(bpy.app.handlers, name).append(handler)
    for drawing in getattr(room, "DRAWINGS", ()):
        drawing.begin()
    for cls in classes_of(room):
        if issubclass(cls, bpy.types.Operator):
            cls.bl_idname = f"unisim.{cls.__name__.removeprefix('UNISIM_OT_')}"
        bpy.utils.register_class(cls)
    for owner, name, value in getattr(room, "PROPERTIES", ()):
        setattr(owner, name, value)
    for menu, draw in getattr(room, "MENUS", ()):
        menu.append(draw)
    configuration = bpy.context.window_manager.keyconfigs.addon
    for shortcut in (
        getattr(room, "SHORTCUTS", ()) if configuration is not None else ()
    ):  # there is none without a window
        keymap = configuration.keymaps.new(name=shortcut.keymap, space_type=shortcut.editor)
        pressed = dict.fromkeys(shortcut.modifiers, True)
        item = keymap.keymap_items.new(shortcut.operator, shortcut.key, "PRESS", **pressed)
        for name, value in shortcut.properties.items():
            setattr(item.properties, name, value)
        _keys.setdefault(room.__name__, []).append((keymap, item))


def close_room(room: ModuleType) -> None:
    """Take it away again."""
    for keymap, item in _keys.pop(room.__name__, ()):
        keymap.keymap_items.remove(item)
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
    for cls in reversed(classes_of(room)):
        bpy.utils.unregister_class(cls)
    if hasattr(room, "unregister"):
        room.unregister()


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
