"""Trajectories as a scenario writes them: keys at times or frames, what is beyond their ends, and when
an actor is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated

from ..checks import require
from ..edit import Edit
from ..json_schema import Schema, SchemaOf, object_of, ref
from .placement import Placement, check_rotation

if TYPE_CHECKING:
    from ...geometry import Trajectory
    from ..context import EditContext
    from ..types import Scenario


@dataclass(frozen=True, kw_only=True)
class Keyframe(Placement):
    """A pose at a time or at a frame's time."""

    time_s: float | None = None
    frame: int | None = None


@dataclass(frozen=True)
class ShiftKey:
    """Distance to the left by which the ego vehicle is shifted at a time or at a frame's time."""

    left_m: float
    time_s: float | None = None
    frame: int | None = None


@dataclass(frozen=True)
class Present:
    """Start and end of an actor's presence; an end that is not given is the drive's."""

    start_s: float | None = None
    end_s: float | None = None


Keyframes = Annotated[tuple[Keyframe, ...], SchemaOf(ref("keyframes"))]
Beyond = Annotated[str, SchemaOf(ref("outside"))]
"""What something does before its first key and after its last: "continue" or "hold"."""
DEFS: dict[str, Schema] = {
    "keyframe": object_of(Keyframe),
    "keyframes": {"type": "array", "items": ref("keyframe"), "minItems": 1},
    "outside": {
        "enum": ["continue", "hold"],
        "description": "Before the first key and after the last: on at the end's velocity, or standing still.",
    },
    "present": object_of(Present),
    "shift_key": object_of(ShiftKey),
}


@dataclass(frozen=True, kw_only=True)
class ActorPathEdit(Edit):
    """An edit that may give an actor a path of its own: a pose to stand at, or keyframes."""

    pose: Placement | None = None
    trajectory: Keyframes | None = None
    outside: Beyond | None = None
    present: Present | None = None

    @property
    def has_path(self) -> bool:
        """Whether it gives a path."""
        return self.pose is not None or self.trajectory is not None

    def check(self, scenario: Scenario, place: str) -> None:
        self.check_path(place, needed=True)

    def check_path(self, place: str, needed: bool) -> None:
        """Raise `ScenarioError` for a path that contradicts itself, or that is missing where it is ``needed``."""
        given = (self.pose is not None) + (self.trajectory is not None)
        require(needed <= given <= 1, place, "needs pose or trajectory, one of them")
        require(self.outside is None or self.trajectory is not None, f"{place}.outside", "needs a trajectory")
        if self.pose is not None:
            check_rotation(self.pose, f"{place}.pose")
        check_keys(self.trajectory or (), f"{place}.trajectory")
        if self.present is not None and self.present.start_s is not None and self.present.end_s is not None:
            start, end = self.present.start_s, self.present.end_s
            require(start <= end, f"{place}.present", f"end_s {end} lies before start_s {start}")

    def path(self, place: str, context: EditContext) -> Trajectory:
        """Return the path that it gives."""
        return context.trajectory(self.pose, self.trajectory, self.outside, place)


PATH_MEMBERS = tuple(field.name for field in fields(ActorPathEdit))


def check_keys(keys: Sequence[Keyframe | ShiftKey], place: str) -> None:
    """Raise `ScenarioError` for keys without a time or with two, and for keys that are not in order."""
    for index, key in enumerate(keys):
        here = f"{place}[{index}]"
        require((key.time_s is None) != (key.frame is None), here, "needs time_s or frame, one of them")
        if isinstance(key, Keyframe):
            check_rotation(key, here)
        for unit in ("time_s", "frame"):
            last, now = getattr(keys[index - 1], unit) if index else None, getattr(key, unit)
            if last is not None and now is not None:
                require(now > last, f"{here}.{unit}", f"{now} must lie after the key before, {last}")
