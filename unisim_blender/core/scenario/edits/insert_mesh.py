"""The edit `insert_mesh`."""

from __future__ import annotations

from dataclasses import dataclass

from ...world.drive import Actor, Appearance, Drive
from ..context import EditContext, check_new, mesh_of, with_actor
from ..edit import register
from ..json_schema import FilePath
from ..motion.keys import ActorPathEdit
from ..motion.trajectories import is_moving

DEFAULT_LABEL = "Other"
"""The class of a mesh whose class nobody told."""


@register
@dataclass(frozen=True)
class InsertMesh(ActorPathEdit):
    """A mesh out of a file, on a path of its own or standing still; ``label`` is its class."""

    type = "insert_mesh"
    meshes = ("mesh",)
    seen_by = "actors"

    mesh: FilePath
    id: str
    label: str | None = None

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        path, size_m = mesh_of(self.mesh, place, context)
        check_new(drive, self.id, place, context)
        trajectory = self.path(place, context)
        start, end = context.presence(self.present, place)
        mesh = Actor(
            self.id, self.label or DEFAULT_LABEL, size_m, trajectory, start, end, is_moving(trajectory),
            Appearance(self.id, mesh=str(path)), inserted=True,
        )  # fmt: skip
        return with_actor(drive, mesh)
