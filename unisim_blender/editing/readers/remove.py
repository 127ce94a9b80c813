"""Reads `remove`: a recorded actor without an object, or with one that is not rendered."""

from __future__ import annotations

from ...core.actor_images.names import plain_names
from ...core.scenario.edits import Remove
from ..edits.lines import EditLine, line_of
from ..edits.reader import ActorReader, Standing, register
from ..texts import Text


@register
class RemoveReader(ActorReader[Remove]):
    """Reads removed actors."""

    of_absent = True

    def read(self, standing: Standing) -> Remove | None:
        """An actor that is there at no frame was not removed."""
        return Remove(standing.known.uid) if standing.recorded_there.any() else None

    def line(self, edit: Remove, standing: Standing) -> EditLine:
        """An actor whose object was deleted has the name that the list of actors gives it."""
        uid, obj = standing.known.uid, standing.obj
        names = standing.names if obj is not None else (plain_names(standing.reading.drive.actors)[uid], "")
        return line_of("ACTOR", uid, "REMOVE", Text("Removed"), names, standing.recorded_there, standing.clock, edit)
