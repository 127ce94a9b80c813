"""Reads `swap`: an actor with the appearance of another one."""

from __future__ import annotations

from pathlib import Path

from ...core.actor_images.names import plain_names
from ...core.scenario.edits import Swap
from ..edits.lines import EditLine, line_of
from ..edits.reader import ActorReader, Standing, register
from ..texts import Text


@register
class SwapReader(ActorReader[Swap]):
    """Reads appearances."""

    def read(self, standing: Standing) -> Swap | None:
        """What the object notes."""
        obj = standing.here
        return Swap(standing.known.uid, obj.appearance, standing.appearance_scene) if obj.appearance else None

    def line(self, edit: Swap, standing: Standing) -> EditLine:
        """Whose appearance it is."""
        actors = standing.reading.drive.actors
        of_this_scene = edit.scene is None and edit.appearance in actors
        named = (
            plain_names(actors)[edit.appearance]
            if of_this_scene
            else Text("{actor} of {scene}", actor=edit.appearance, scene=Path(edit.scene or "").name)
        )
        words, there = Text("Appearance of {actor}", actor=named), standing.here.there
        return line_of("ACTOR", edit.actor, "APPEARANCE", words, standing.names, there, standing.clock, edit)
