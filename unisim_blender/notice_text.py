"""Sentences about what a 3D view cannot show, written over its upper edge."""

from __future__ import annotations

import blf
import bpy

from .bridge.objects.source import source_of
from .bridge.views.notices import notices
from .core.errors import UnisimError
from .registering import Drawing
from .view_types import looks_through

SIZE, LINE, TOP = 12.0, 18.0, 70.0
"""Height of the text, from line to line, and from the view's upper edge, in points of an ordinary display."""
COLOUR = (1.0, 0.82, 0.35, 1.0)


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    context = bpy.context
    scene, space, region = context.scene, context.space_data, context.region
    if not scene.unisim.log or not space.overlay.show_overlays:
        return
    rendered = space.shading.type == "RENDERED" and scene.render.engine == "UNISIM"
    camera = scene.camera if looks_through(scene, space) == "RIG" and not rendered else None
    try:
        lines = notices(scene, source_of(scene), camera)
    except (UnisimError, OSError):
        return  # the panel says so
    scale = context.preferences.system.ui_scale
    blf.size(0, SIZE * scale)
    blf.color(0, *COLOUR)
    for row, line in enumerate(lines):
        width, _ = blf.dimensions(0, line)
        blf.position(0, (region.width - width) / 2, region.height - (TOP + LINE * row) * scale, 0.0)
        blf.draw(0, line)


_drawing = Drawing(draw, "POST_PIXEL")


def register() -> None:
    """Write from now on."""
    _drawing.begin()


def unregister() -> None:
    """Write no more."""
    _drawing.end()
