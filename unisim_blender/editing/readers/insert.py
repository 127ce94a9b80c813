"""Reads `insert`: an object with an appearance that is not its source's, or of an actor that the recording does not have."""

from __future__ import annotations

from ...core.scenario.edits import Insert
from ..edits.lines import Line, line_of
from ..edits.reader import NewActorReader, Standing, register
from ..edits.trajectories import present
from ..texts import Text


@register
class InsertReader(NewActorReader[Insert]):
    """Reads inserted actors."""

    def reads(self, standing: Standing) -> bool:
        """A copy with its source's appearance is a duplicate; without a recorded actor there may be a mesh."""
        thing = standing.here
        return bool(thing.appearance) if standing.actor is not None else not thing.mesh

    def read(self, standing: Standing) -> Insert:
        """The object's appearance and path."""
        thing = standing.here
        uid = standing.reading.new_id(thing)
        path = Standing(standing.reading, thing, None).path()
        return Insert(
            thing.appearance or thing.uid, uid, standing.appearance_scene, **path, present=present(standing.clock, thing.there)
        )

    def line(self, edit: Insert, standing: Standing) -> Line:
        """That it is there."""
        thing = standing.here
        return line_of("ACTOR", thing.uid, "INSERT", Text("Inserted"), standing.names, thing.there, standing.clock, edit)
