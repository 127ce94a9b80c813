"""Everything that the add-on adds to Blender, and takes away again."""

from __future__ import annotations

import bpy

from . import (
    batch_properties,
    client,
    clouds,
    compare_view,
    documentation,
    edit_properties,
    edit_watch,
    engine,
    following,
    gizmos,
    headless,
    lens_overlay,
    listing,
    menus,
    notice_text,
    operators,
    overlay,
    panels,
    pie,
    preferences,
    properties,
    rollout_overlay,
    simulation_properties,
    speed_overlay,
    thumbnails,
    timeline,
    translations,
    view_options,
    view_types,
)
from .bridge.sampling import adjacent_frames
from .core.errors import install_into
from .interpreters import MODULES
from .registering import close_room, open_room

ROOMS = (
    translations,
    properties,
    edit_properties,
    simulation_properties,
    batch_properties,
    view_options,
    preferences,
    adjacent_frames,
    following,
    edit_watch,
    listing,
    thumbnails,
    *operators.MODULES,
    *panels.MODULES,
    menus,
    pie,
    lens_overlay,
    overlay,
    rollout_overlay,
    speed_overlay,
    gizmos,
    clouds,
    notice_text,
    timeline,
    view_types,
    compare_view,
    engine,
    documentation,
)
"""In the order in which they need each other."""

_commands: list[object] = []
"""What `blender --command` was taught."""


def register() -> None:
    """Add everything to Blender."""
    if bpy.app.binary_path:  # Blender's module lives in somebody else's Python
        install_into(str(MODULES))
    for room in ROOMS:
        open_room(room)
    _commands.append(bpy.utils.register_cli_command("unisim", headless.command))


def unregister() -> None:
    """Take everything away again, and end the worker."""
    client.close()
    install_into("")
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    for room in reversed(ROOMS):
        close_room(room)
