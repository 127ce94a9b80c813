"""Reads `insert`: an object with an appearance that is not its source's, or of an actor that the
recording does not have."""

from __future__ import annotations

from ...core.scenario.edits import Insert
from ..edits.lines import EditLine, line_of
from ..edits.reader import NewActorReader, Standing, register
from ..edits.trajectories import present
from ..texts import Text


@register
class InsertReader(NewActorReader[Insert]):
    """Reads inserted actors."""

    def reads(self, standing: Standing) -> bool:
        """A copy with its source's appearance is a duplicate; without a recorded actor there may be a mesh."""
        obj = standing.here
        return bool(obj.appearance) if standing.actor is not None else not obj.mesh

    def read(self, standing: Standing) -> Insert:
        """The object's appearance and path."""
        obj = standing.here
        uid = standing.reading.new_id(obj)
        path = Standing(standing.reading, obj, None).path()
        return Insert(
            obj.appearance or obj.uid,
            uid,
            standing.appearance_scene,
            **path,
            present=present(standing.clock, obj.there),
        )

    def line(self, edit: Insert, standing: Standing) -> EditLine:
        """That it is there."""
        obj = standing.here
        return line_of("ACTOR", obj.uid, "INSERT", Text("Inserted"), standing.names, obj.there, standing.clock, edit)
