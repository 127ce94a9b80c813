"""Where a 3D view has its overlays, which are laid out together; and what they are drawn with: triangles, lines, and rows
of text on a dark ground, which can be read on any image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import blf
import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from numpy.typing import NDArray

from ..bridge.window import free_rectangle
from ..core.geometry import FloatArray
from ..editing.layout.overlays import OverlayLayout, lay_out_overlays
from ..editing.layout.shapes import OverlayShapes
from ..editing.texts import wrapped
from ..translations import localized

WANTED: dict[str, Callable[[bpy.types.Context], tuple[float, float] | None]] = {}
"""Functions that return the width and height of an overlay at a scale of 1, None while it is not shown."""
LETTERS_PX = 11.0
"""Size of the letters of shapes."""
TEXT_PX, LINE_PX, PAD_PX = 12.0, 17.0, 5.0
"""Size of the text, from line to line, and its distance from the ground's edge."""
GROUND = (0.04, 0.04, 0.04, 0.78)


def overlay_layout(context: bpy.types.Context) -> OverlayLayout:
    """Return the layout of the 3D view of a context."""
    area, space = context.area, context.space_data
    region = context.region
    if region is None or region.type != "WINDOW":
        region = next(one for one in area.regions if one.type == "WINDOW")
    sizes = {name: size_of(context) for name, size_of in WANTED.items()}
    wanted = {name: size for name, size in sizes.items() if size is not None}
    gizmos = space.show_gizmo and space.show_gizmo_navigate
    return lay_out_overlays(free_rectangle(area, region), context.preferences.system.ui_scale, wanted, gizmos)


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
    draw_batch("TRI_STRIP", ((x0, y0), (x1, y0), (x0, y1), (x1, y1)), colour)


def point_shader() -> Any:
    """Return the shader of points that have a colour each."""
    try:
        return gpu.shader.from_builtin("POINT_FLAT_COLOR")
    except ValueError:  # before Blender 4.5
        return gpu.shader.from_builtin("FLAT_COLOR")


def draw_batch(primitive: str, points: Any, colours: Any, line_px: float = 1.0) -> None:
    """Draw triangles, lines or points over what is there: points (N, 2) or (N, 3), and a colour for each (N, 4) or for all
    (4,)."""
    points = np.asarray(points, np.float32)
    shader = point_shader() if primitive == "POINTS" else gpu.shader.from_builtin("SMOOTH_COLOR")
    each = one_for_each(colours, len(points))
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("NONE")
    gpu.state.line_width_set(line_px)
    gpu.state.point_size_set(line_px)
    batch_for_shader(shader, primitive, {"pos": points, "color": each}).draw(shader)
    gpu.state.line_width_set(1.0)
    gpu.state.point_size_set(1.0)
    gpu.state.blend_set("NONE")


def one_for_each(colours: Any, count: int) -> NDArray[np.float32]:
    """Return a colour (4,) or colours (N, 4) as colours (N, 4), row by row in memory as graphics cards read them."""
    return np.ascontiguousarray(np.broadcast_to(colours, (count, 4)), np.float32)


def measure_at(scale: float) -> Callable[[str], float]:
    """Return what measures the width of a text that `draw_shapes` draws, in pixels."""
    blf.size(0, LETTERS_PX * scale)
    return lambda text: float(blf.dimensions(0, localized(text))[0])


def draw_shapes(
    shapes: OverlayShapes,
    corner: Sequence[float] | FloatArray = (0.0, 0.0),
    scale: float = 1.0,
    text_scale: float | None = None,
) -> None:
    """Draw shapes with their lower left at a corner (2,) of the region; ``text_scale`` is that of letters where it is
    another one."""
    if shapes.corners:
        draw_batch("TRIS", *shapes.arrays(corner, scale))
    blf.size(0, LETTERS_PX * (scale if text_scale is None else text_scale))
    for text, x, y, colour in shapes.texts:
        blf.color(0, *colour)
        blf.position(0, corner[0] + scale * x, corner[1] + scale * y, 0)
        blf.draw(0, localized(text))
