"""Everything that the add-on adds to Blender, and takes away again."""

from __future__ import annotations

from importlib import import_module

import bpy

from . import headless
from .core.errors import install_into
from .process import client, interpreters
from .registering import add_module, remove_module

MODULES = tuple(
    import_module(f".{name}", __package__)
    for name in """
    translations features.drive.properties features.edits.properties features.simulation.properties
    features.batch.properties features.tracks.properties
    viewport.options preferences bridge.sampling.adjacent_frames bridge.changes.following
    features.edits.watch features.actor_list.listing features.actors.thumbnails

    features.motion.properties features.drive.import_operators features.drive.export_operators
    features.actor_list.operators features.actors.operators features.edits.operators features.actors.appearances
    features.motion.operators features.motion.maneuvers features.sensors.operators features.motion.drag
    features.motion.rows features.sensors.rig_presets features.points.operators features.points.birds_eye
    features.tracks.following features.tracks.operators
    process.background process.preparation features.output.operators features.simulation.operators
    features.batch.operators features.variants.operators process.interpreters process.packages features.problems
    features.settings features.actors.assets

    features.sidebar features.first_steps features.drive.panel features.actor_list.panel features.actors.panel
    features.actors.lamps features.motion.panel features.tracks.panel features.edits.panel features.variants.panel
    features.ego features.sensors.panel features.weather features.check features.output.panel features.training
    features.simulation.panel features.batch.panel
    panels.statusbar

    operators.menus viewport.overlays features.simulation.overlay features.motion.overlay features.motion.gizmos
    features.points.clouds features.tracks.sides
    features.actor_list.timeline viewport.view_types viewport.compare_view viewport.notice_text
    viewport.engine operators.documentation
    """.split()
)
"""Modules in the order in which they need each other: properties, operators, panels in the order of the sidebar, and what views
and menus show."""

_commands: list[object] = []
"""Commands that were added to `blender --command`."""


def register() -> None:
    """Add everything to Blender."""
    if bpy.app.binary_path:  # Blender's module lives in somebody else's Python
        install_into(str(interpreters.MODULES), not bpy.app.background)
    for module in MODULES:
        add_module(module)
    _commands.append(bpy.utils.register_cli_command("unisim", headless.command))


def unregister() -> None:
    """Take everything away again, and end the worker."""
    client.close()
    install_into("")
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    for module in reversed(MODULES):
        remove_module(module)
