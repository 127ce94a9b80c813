"""The edit `retime`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ...world.drive import Drive
from ..checks import require
from ..context import EditContext, current, with_actor
from ..edit import Edit, register
from ..json_schema import Positive, SchemaOf
from ..motion.trajectories import TimeMap, retimed
from ..types import Scenario


@register
@dataclass(frozen=True)
class Retime(Edit):
    """The same path at other times: later, faster, or by pairs of (scenario time, recorded time)."""

    type = "retime"
    unseen_because = "keys of a Blender object are places at frames: a retimed actor is read as one that is moved"

    actor: str
    offset_s: float | None = None
    speed: Positive | None = None
    pivot_s: float | None = None
    map: tuple[tuple[float, float], ...] | None = None
    outside: Annotated[str, SchemaOf({"enum": ["absent", "hold", "continue"]})] | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        if self.map is None:
            require(self.offset_s is not None or self.speed is not None, place, "needs offset_s, speed or map")
            require(self.pivot_s is None or self.speed is not None, f"{place}.pivot_s", "needs a speed")
            require(self.speed is None or self.speed > 0, f"{place}.speed", f"must be above 0, not {self.speed}")
            return
        alone = self.offset_s is None and self.speed is None and self.pivot_s is None
        require(alone, place, "has offset_s, speed or pivot_s beside map, which exclude each other")
        for index, ((before, recorded_before), (after, recorded)) in enumerate(
            zip(self.map, self.map[1:], strict=False), 1
        ):
            require(after > before, f"{place}.map[{index}]", f"scenario time {after} must lie after {before}")
            require(
                recorded >= recorded_before,
                f"{place}.map[{index}]",
                f"recorded time {recorded} must not lie before {recorded_before}",
            )

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        actor = current(drive, self.actor, f"{place}.actor", context)
        time_map = self._time_map(place, context)
        start, end = context.presence(None, place)
        if self.outside == "hold":
            time_map = time_map.clamped(actor.start_s, actor.end_s)
        elif self.outside != "continue":
            start, end = time_map.scenario(actor.start_s), time_map.scenario(actor.end_s, latest=True)
        trajectory = retimed(actor.world_from_actor, time_map)
        return with_actor(drive, replace(actor, world_from_actor=trajectory, start_s=start, end_s=end))

    def _time_map(self, place: str, context: EditContext) -> TimeMap:
        if self.map is not None:
            for index, pair in enumerate(self.map):
                for time in pair:
                    context.check_time(time, f"{place}.map[{index}]")
            scenario, recorded = np.array(self.map, float).T
            return TimeMap(scenario, recorded)
        first = min(context.recorded.time_s.values())
        pivot = first if self.pivot_s is None else context.check_time(self.pivot_s, f"{place}.pivot_s")
        return TimeMap(np.array([pivot + (self.offset_s or 0.0)]), np.array([pivot]), float(self.speed or 1.0))
