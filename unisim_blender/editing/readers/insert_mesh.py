"""Reads `insert_mesh`: an object that is a mesh."""

from __future__ import annotations

from ...core.scenario.edits import InsertMesh
from ..edits.lines import EditLine, line_of
from ..edits.reader import NewActorReader, Standing, register
from ..edits.trajectories import present
from ..texts import Text


@register
class InsertMeshReader(NewActorReader[InsertMesh]):
    """Reads meshes."""

    def reads(self, standing: Standing) -> bool:
        """Its own surface is what is rendered."""
        return standing.actor is None and bool(standing.here.mesh)

    def read(self, standing: Standing) -> InsertMesh:
        """The model's file and the object's path."""
        obj, reading = standing.here, standing.reading
        uid, when = reading.new_id(obj), present(standing.clock, obj.there)
        return InsertMesh(reading.relative(obj.mesh), uid, obj.label or None, **standing.path(), present=when)

    def line(self, edit: InsertMesh, standing: Standing) -> EditLine:
        """That it is there."""
        obj = standing.here
        return line_of("ACTOR", obj.uid, "MESH", Text("Mesh inserted"), standing.names, obj.there, standing.clock, edit)
