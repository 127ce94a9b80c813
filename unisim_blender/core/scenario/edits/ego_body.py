"""The edit `ego_body`: a body that rides on the vehicle, and that only sensors that do not ride there see."""

from __future__ import annotations

from dataclasses import dataclass

from ...world.drive import Actor, Appearance, Drive
from ..context import EditContext, check_new, mesh_of, riding, with_actor
from ..edit import Edit, register
from ..json_schema import FilePath
from ..motion.placement import Placement, check_rotation, pose_of
from ..motion.trajectories import is_moving
from ..types import Scenario

DEFAULT_LABEL = "Car"
"""The class of a body whose class nobody told."""


@register
@dataclass(frozen=True)
class EgoBody(Edit):
    """A mesh out of a file that is the ego vehicle's body: it rides at ``mount``, and the vehicle's own
    sensors do not see it."""

    type = "ego_body"
    meshes = ("mesh",)
    seen_by = "ego"

    mesh: FilePath
    id: str
    mount: Placement
    label: str | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        check_rotation(self.mount, f"{place}.mount")

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with a mesh on the vehicle, wherever edits before and after this one let it drive."""
        path, size_m = mesh_of(self.mesh, place, context)
        check_new(drive, self.id, place, context)
        trajectory = riding(drive, pose_of(self.mount))
        start, end = context.presence(None, place)
        body = Actor(
            self.id, self.label or DEFAULT_LABEL, size_m, trajectory, start, end, is_moving(trajectory),
            Appearance(self.id, mesh=str(path)), inserted=True, is_ego_body=True,
        )  # fmt: skip
        return with_actor(drive, body)
