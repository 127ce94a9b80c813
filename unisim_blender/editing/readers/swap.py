"""Reads `swap`: an actor with the appearance of another one."""

from __future__ import annotations

from pathlib import Path

from ...core.actor_images.names import plain_names
from ...core.scenario.edits import Swap
from ..edits.lines import Line, line_of
from ..edits.reader import ActorReader, Standing, register
from ..texts import Text


@register
class SwapReader(ActorReader[Swap]):
    """Reads appearances."""

    def read(self, standing: Standing) -> Swap | None:
        """What the object notes."""
        thing = standing.here
        return Swap(standing.known.uid, thing.appearance, standing.appearance_scene) if thing.appearance else None

    def line(self, edit: Swap, standing: Standing) -> Line:
        """Whose appearance it is."""
        actors = standing.reading.drive.actors
        own_look = edit.scene is None and edit.look in actors
        named = (
            plain_names(actors)[edit.look]
            if own_look
            else Text("{actor} of {scene}", actor=edit.look, scene=Path(edit.scene or "").name)
        )
        words, there = Text("Appearance of {actor}", actor=named), standing.here.there
        return line_of("ACTOR", edit.actor, "APPEARANCE", words, standing.names, there, standing.clock, edit)
