"""One edit taken back: the object stands as it was imported."""

from __future__ import annotations

import bpy

from ...editing.edits.lines import Line
from ...editing.sampled.source import Source
from . import carriers  # noqa: F401 so that all are registered
from .carriers.carrier import carrier_of


def revert(scene: bpy.types.Scene, source: Source, line: Line) -> None:
    """Take an edit of a scene back; what else is edited stays.

    A removed object comes back, a copied or inserted one is deleted, a moved one gets its recorded trajectory and no
    displacement. Raises `UnisimError`.
    """
    carrier_of(line.part).revert(scene, source, line, scene.objects.get(line.object_name))
