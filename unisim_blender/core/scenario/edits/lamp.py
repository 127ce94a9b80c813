"""The edit `lamp`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ...errors import UnisimError
from ...world.drive import Drive
from ...world.lamps import STATES
from ..checks import fail, listed, require
from ..context import EditContext, current, with_actor
from ..edit import Edit, register
from ..types import Scenario


@register
@dataclass(frozen=True)
class Lamp(Edit):
    """Show the actor's lamp in a state that the log shows too, from one time to another; before and after, as the log does."""

    type = "lamp"
    seen_by = "lamps"

    actor: str
    state: str
    lamp: str | None = None
    from_s: float | None = None
    to_s: float | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        require(self.state in STATES, f"{place}.state", f'no lamp is "{self.state}" {listed(STATES)}')
        ordered = self.from_s is None or self.to_s is None or self.from_s < self.to_s
        require(ordered, f"{place}.to_s", f"{self.to_s} must lie after from_s, {self.from_s}")

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with the actor's lamp in the state, and else in those of the log and of earlier edits; the drive as it
        is where nobody looks at the log's images, which show how a lamp looks."""
        actor = current(drive, self.actor, f"{place}.actor", context)
        if context.recorded_lamps is None:
            return drive
        try:
            recorded = context.recorded_lamps()
        except UnisimError as fault:
            fail(place, f"the log's images show how a lamp looks: {fault}")
        own = actor.appearance.scene == actor.appearance.mesh == ""
        lamps = recorded.get(actor.appearance.actor, ()) if own else ()
        if not lamps:
            known = ", ".join(sorted(recorded)) or "none"
            fail(
                f"{place}.actor",
                f'the log shows "{self.actor}" in one state alone; actors with lamps that change: {known}',
            )
        named = [lamp for lamp in lamps if self.lamp in (None, lamp.name)]
        if len(named) != 1:
            problem = "several lamps" if named else "no such lamp"
            fail(f"{place}.lamp", f'"{self.actor}" has {problem} {listed([lamp.name for lamp in lamps])}')
        lamp = next((lamp for lamp in actor.lamps if lamp.name == named[0].name), named[0])
        if self.state not in lamp.states:
            fail(f"{place}.state", f'the log does not show "{self.state}" of "{self.actor}" {listed(lamp.states)}')
        from_s = -math.inf if self.from_s is None else context.check_time(self.from_s, f"{place}.from_s")
        to_s = math.inf if self.to_s is None else context.check_time(self.to_s, f"{place}.to_s")
        others = tuple(other for other in actor.lamps if other.name != lamp.name)
        return with_actor(drive, replace(actor, lamps=(*others, lamp.switched(self.state, from_s, to_s))))
