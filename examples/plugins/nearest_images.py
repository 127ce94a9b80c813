"""A fixer: colours of the nearest recorded images where these show a surface, elsewhere of what is around."""

from __future__ import annotations

from unisim_blender.core.render.fixers import ImageToFix
from unisim_blender.core.render.plane_fill import filled
from unisim_blender.core.render.tracer import Array


def fix(view: ImageToFix) -> Array:
    """Return the image with what no recorded image shows, and is not filled, interpolated from the pixels around."""
    image, known = view.image.copy(), (view.weight == 0) | (view.filled > 0.5)
    for reference in reversed(view.references):
        image[reference.shown & ~known] = reference.warped[reference.shown & ~known]
    for reference in view.references:
        known |= reference.shown
    return filled(image, known, along=0)
