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


def classes_of(module: ModuleType) -> list[Any]:
    """Return the classes of Blender's that a module defines, in their order."""
    return [
        cls
        for cls in vars(module).values()
        if isinstance(cls, type) and issubclass(cls, bpy.types.bpy_struct) and cls.__module__ == module.__name__
    ]


def add_module(module: ModuleType) -> None:
    """Add what a module has for Blender. Operators are called as their classes: UNISIM_OT_check is `unisim.check`."""
    if hasattr(module, "register"):
        module.register()
    for name, handler in getattr(module, "HANDLERS", ()):
        getattr(bpy.app.handlers, name).append(handler)
    for drawing in getattr(module, "DRAWINGS", ()):
        drawing.begin()
    for cls in classes_of(module):
        if issubclass(cls, bpy.types.Operator):
            cls.bl_idname = f"unisim.{cls.__name__.removeprefix('UNISIM_OT_')}"
        bpy.utils.register_class(cls)
    for owner, name, value in getattr(module, "PROPERTIES", ()):
        setattr(owner, name, value)
    for menu, draw in getattr(module, "MENUS", ()):
        menu.append(draw)
    configuration = bpy.context.window_manager.keyconfigs.addon
    shortcuts = getattr(module, "SHORTCUTS", ()) if configuration is not None else ()  # without a window there is none
    for shortcut in shortcuts:
        keymap = configuration.keymaps.new(name=shortcut.keymap, space_type=shortcut.editor)
        pressed = dict.fromkeys(shortcut.modifiers, True)
        item = keymap.keymap_items.new(shortcut.operator, shortcut.key, "PRESS", **pressed)
        for name, value in shortcut.properties.items():
            setattr(item.properties, name, value)
        _keys.setdefault(module.__name__, []).append((keymap, item))


def remove_module(module: ModuleType) -> None:
    """Take it away again."""
    for keymap, item in _keys.pop(module.__name__, ()):
        keymap.keymap_items.remove(item)
    for name, handler in getattr(module, "HANDLERS", ()):
        with suppress(ValueError):  # opening a file drops handlers that are not persistent
            getattr(bpy.app.handlers, name).remove(handler)
    for drawing in getattr(module, "DRAWINGS", ()):
        drawing.end()
    for timer in getattr(module, "TIMERS", ()):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    for menu, draw in getattr(module, "MENUS", ()):
        menu.remove(draw)
    for owner, name, _ in getattr(module, "PROPERTIES", ()):
        delattr(owner, name)
    for cls in reversed(classes_of(module)):
        bpy.utils.unregister_class(cls)
    if hasattr(module, "unregister"):
        module.unregister()


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
