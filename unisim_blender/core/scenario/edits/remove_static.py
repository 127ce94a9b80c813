"""The edit `remove_static`: of what carries no annotation. The ground in its box stays."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...world.drive import Drive
from ..context import EditContext, box_of, check_box
from ..edit import Edit, register
from ..types import Scenario


@register
@dataclass(frozen=True)
class RemoveStatic(Edit):
    """What stands in the box is not there."""

    type = "remove_static"
    seen_by = "static_items"

    box: str

    def check(self, scenario: Scenario, place: str) -> None:
        check_box(self.box, scenario, place)

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        return replace(drive, static_removals=(*drive.static_removals, box_of(self.box, context.scenario)))
