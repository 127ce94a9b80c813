"""Reads `ego_body`: meshes that are fixed to the recording vehicle."""

from __future__ import annotations

from collections.abc import Iterator

from ...core.errors import ScenarioError
from ...core.geometry import invert_pose
from ...core.scenario.edits import EgoBody
from ..edits.lines import EditLine, line_of
from ..edits.reader import GroupReader, ReadContext, register
from ..edits.trajectories import placement
from ..sampled.poses import same
from ..texts import Text


@register
class EgoBodies(GroupReader):
    """Reads the vehicle's bodies."""

    group = "RIG"
    kinds = ("BODY",)

    def edits(self, reading: ReadContext) -> Iterator[EgoBody]:
        """An edit for each body. Raises `ScenarioError` for one that is not fixed to the vehicle."""
        ego = next(reading.sampled.of("EGO"), None)
        for obj in reading.sampled.of("BODY"):
            if not obj.there.any():
                continue
            if ego is None:
                raise ScenarioError(
                    f'object "{obj.name}": is a body of the ego vehicle, which is not there: undo that it was deleted'
                )
            mount = invert_pose(ego.poses) @ obj.poses
            if not same(mount, mount[:1]).all():
                raise ScenarioError(
                    f'object "{obj.name}": moves on the ego vehicle, which its body is fixed to: keep it parented to the '
                    "vehicle, and clear its keys and constraints"
                )
            yield EgoBody(reading.relative(obj.mesh), reading.new_id(obj), placement(mount[0]), obj.label or None)

    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        """A line for each body."""
        bodies = [obj for obj in reading.sampled.of("BODY") if obj.there.any()]
        for body, obj in zip(self.edits(reading), bodies, strict=True):
            names, words = (obj.title, obj.name), Text("Body of the ego vehicle")
            yield line_of("BODY", obj.uid, "BODY", words, names, obj.there, reading.clock, body)
