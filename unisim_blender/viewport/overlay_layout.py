"""Where a 3D view has its overlays, which are laid out together; and lines of text on a dark ground, which can be read on
any image."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import blf
import bpy

from ..editing.layout.overlays import OverlayLayout, Rectangle, free_part, lay_out_overlays
from ..editing.texts import wrapped

WANTED: dict[str, Callable[[bpy.types.Context], tuple[float, float] | None]] = {}
"""Functions that return the width and height of an overlay at a scale of 1, None while it is not shown."""
TEXT_PX, LINE_PX, PAD_PX = 12.0, 17.0, 5.0
"""Size of the text, from line to line, and its distance from the ground's edge."""
GROUND = (0.04, 0.04, 0.04, 0.78)


def overlay_layout(context: bpy.types.Context) -> OverlayLayout:
    """Return the layout of the 3D view of a context."""
    area, space = context.area, context.space_data
    region = context.region
    if region is None or region.type != "WINDOW":
        region = next(one for one in area.regions if one.type == "WINDOW")
    boxes = [
        (one.type, Rectangle(x, y, x + one.width, y + one.height))
        for one in area.regions
        for x, y in [(one.x - region.x, one.y - region.y)]
    ]
    free = free_part(region.width, region.height, boxes)
    sizes = {name: size_of(context) for name, size_of in WANTED.items()}
    wanted = {name: size for name, size in sizes.items() if size is not None}
    gizmos = space.show_gizmo and space.show_gizmo_navigate
    return lay_out_overlays(free, context.preferences.system.ui_scale, wanted, gizmos)


def in_rows(texts: Sequence[str], width: float, scale: float) -> list[str]:
    """Return texts in rows no wider than ``width`` with their ground."""
    blf.size(0, TEXT_PX * scale)
    room = max(width - 2 * PAD_PX * scale, TEXT_PX * scale)
    return [row for text in texts for row in wrapped(text, room, room, lambda part: float(blf.dimensions(0, part)[0]))]


def ground_size(rows: Sequence[str], scale: float) -> tuple[float, float]:
    """Return the width and height of rows with their ground."""
    blf.size(0, TEXT_PX * scale)
    width = max((float(blf.dimensions(0, row)[0]) for row in rows), default=0.0)
    return width + 2 * PAD_PX * scale, (LINE_PX * len(rows) + PAD_PX) * scale


def write_rows(rows: Sequence[str], left: float, top: float, scale: float, colour: tuple[float, ...]) -> None:
    """Write centred rows on their ground, which begins at the upper left corner (left, top)."""
    width, height = ground_size(rows, scale)
    fill(left, top - height, left + width, top, GROUND)
    blf.color(0, *colour)
    for number, row in enumerate(rows):
        x = left + (width - blf.dimensions(0, row)[0]) / 2
        blf.position(0, x, top - (LINE_PX * (number + 1) - 1) * scale, 0.0)
        blf.draw(0, row)


def fill(x0: float, y0: float, x1: float, y1: float, colour: tuple[float, ...]) -> None:
    """Draw a rectangle."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    batch = batch_for_shader(shader, "TRI_STRIP", {"pos": ((x0, y0), (x1, y0), (x0, y1), (x1, y1))})
    gpu.state.blend_set("ALPHA")
    shader.uniform_float("color", colour)
    batch.draw(shader)
    gpu.state.blend_set("NONE")
