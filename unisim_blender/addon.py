"""Everything that the add-on adds to Blender, and takes away again."""

from __future__ import annotations

import bpy

from . import headless, operators, panels, preferences, translations
from .bridge.changes import following
from .bridge.sampling import adjacent_frames
from .core.errors import install_into
from .features.actor_list import listing, timeline
from .features.actors import thumbnails
from .features.batch import properties as batch_properties
from .features.drive import properties as drive_properties
from .features.edits import properties as edit_properties
from .features.edits import watch as edit_watch
from .features.motion import gizmos
from .features.motion import overlay as speed_overlay
from .features.points import clouds
from .features.simulation import overlay as rollout_overlay
from .features.simulation import properties as simulation_properties
from .operators import documentation, menus
from .process import client
from .process.interpreters import MODULES
from .registering import close_room, open_room
from .viewport import compare_view, engine, notice_text, overlays, view_types
from .viewport import options as view_options

ROOMS = (
    translations,
    drive_properties,
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
    overlays,
    rollout_overlay,
    speed_overlay,
    gizmos,
    clouds,
    timeline,
    view_types,
    compare_view,
    notice_text,
    engine,
    documentation,
)
"""In the order in which they need each other."""

_commands: list[object] = []
"""Commands that were added to `blender --command`."""


def register() -> None:
    """Add everything to Blender."""
    if bpy.app.binary_path:  # Blender's module lives in somebody else's Python
        install_into(str(MODULES), not bpy.app.background)
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
