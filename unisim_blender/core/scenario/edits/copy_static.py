"""The edit `copy_static`: of what carries no annotation. The ground in its box stays."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...world.drive import Drive, StaticCopy
from ..checks import fail
from ..context import EditContext, box_of, check_box
from ..edit import Edit, register
from ..motion.placement import Placement, check_rotation, pose_of
from ..types import Scenario


@register
@dataclass(frozen=True)
class CopyStatic(Edit):
    """What stands in the box stands also at the target."""

    type = "copy_static"
    seen_by = "static_items"

    box: str
    id: str
    target: Placement

    def check(self, scenario: Scenario, place: str) -> None:
        check_rotation(self.target, f"{place}.target")
        check_box(self.box, scenario, place)

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        if self.id in context.recorded.actors or self.id in drive.actors:
            fail(f"{place}.id", f'"{self.id}" is an actor already')
        copy = StaticCopy(self.id, box_of(self.box, context.scenario), pose_of(self.target))
        return replace(drive, static_copies=(*drive.static_copies, copy))
