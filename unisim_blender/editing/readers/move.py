"""Reads `move`: an actor that goes elsewhere than it was recorded, or is there at other times."""

from __future__ import annotations

from ...core.scenario.edits import Move
from ..edits.lines import EditLine, line_of
from ..edits.path_words import path_words
from ..edits.reader import ActorReader, Standing, register
from ..edits.trajectories import present
from ..sampled.poses import same
from ..texts import Text


@register
class MoveReader(ActorReader[Move]):
    """Reads trajectories and places."""

    def read(self, standing: Standing) -> Move | None:
        """The object's poses, where they are not those of the recorded actor on its ground."""
        obj, there = standing.here, standing.recorded_there
        changed = bool((obj.there != there).any())
        if not changed and same(obj.poses, standing.lifted)[there].all():
            return None
        return Move(
            standing.known.uid, **standing.path(), present=present(standing.clock, obj.there) if changed else None
        )

    def line(self, edit: Move, standing: Standing) -> EditLine | None:
        """How it goes elsewhere; None where it was moved for its scale alone, which has a line of its own."""
        obj, there, raised = standing.here, standing.recorded_there, standing.raised
        differs = (obj.there != there) | (obj.there & ~same(obj.poses, raised))
        if obj.scale_lift_m and not differs.any():
            return None
        words = path_words(obj, standing.recorded, raised, there, standing.known, standing.clock)
        return line_of(
            "ACTOR", edit.actor, "MOVE", words or Text("Moved"), standing.names, differs, standing.clock, edit
        )
