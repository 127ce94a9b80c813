"""The edit `insert_mesh`."""

from __future__ import annotations

from dataclasses import dataclass

from ...world.drive import Actor, Appearance, Drive
from ..context import EditContext, check_new, mesh_of, with_actor
from ..edit import Edit, register
from ..json_schema import PATH, TEXT
from ..motion.keys import ACTOR_PATH, Keyframe, Present, check_path
from ..motion.placement import Placement
from ..motion.trajectories import is_moving
from ..types import Scenario

DEFAULT_LABEL = "Other"
"""The class of a mesh whose class nobody told."""


@register
@dataclass(frozen=True)
class InsertMesh(Edit):
    """A mesh out of a file, on a path of its own or standing still; ``label`` is its class."""

    type = "insert_mesh"
    members = {"mesh": PATH, "id": TEXT, "label": TEXT, **ACTOR_PATH}
    meshes = ("mesh",)
    seen_by = "actors"

    mesh: str
    id: str
    label: str | None = None
    pose: Placement | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    outside: str | None = None
    present: Present | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        """Refuse a path that is missing or contradicts itself."""
        check_path(self, place)

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with a mesh in it; its box is the mesh's extent."""
        path, size_m = mesh_of(self.mesh, place, context)
        check_new(drive, self.id, place, context)
        trajectory = context.trajectory(self.pose, self.trajectory, self.outside, place)
        start, end = context.presence(self.present, place)
        label, moving, appearance = (
            self.label or DEFAULT_LABEL,
            is_moving(trajectory),
            Appearance(self.id, mesh=str(path)),
        )
        return with_actor(
            drive, Actor(self.id, label, size_m, trajectory, start, end, moving, appearance, inserted=True)
        )
