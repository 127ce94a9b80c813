"""Trajectories as a scenario writes them: keys at times or frames, what is beyond their ends, and when
an actor is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ..checks import require
from ..json_schema import FRAME, NUMBER, Schema, members_of, ref
from .placement import POSE, Placement, check_rotation


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


TIME: dict[str, Schema] = {"time_s": NUMBER, "frame": FRAME}
DEFS: dict[str, Schema] = {
    "keyframe": members_of({**TIME, **POSE}, ["position"]),
    "keyframes": {"type": "array", "items": ref("keyframe"), "minItems": 1},
    "outside": {
        "enum": ["continue", "hold"],
        "description": "Before the first key and after the last: on at the end's velocity, or standing still.",
    },
    "present": members_of({"start_s": NUMBER, "end_s": NUMBER}),
    "shift_key": members_of({**TIME, "left_m": NUMBER}, ["left_m"]),
}
ACTOR_PATH: dict[str, Schema] = {
    "pose": ref("placement"),
    "trajectory": ref("keyframes"),
    "outside": ref("outside"),
    "present": ref("present"),
}
"""Members of an edit that gives an actor a path of its own."""


class ActorPathEdit(Protocol):
    """An edit with the members of `ACTOR_PATH`."""

    @property
    def pose(self) -> Placement | None:
        """The pose of an actor that stands."""

    @property
    def trajectory(self) -> tuple[Keyframe, ...] | None:
        """The keyframes of its trajectory."""

    @property
    def outside(self) -> str | None:
        """Behaviour beyond the keys."""

    @property
    def present(self) -> Present | None:
        """Its presence."""


def check_path(edit: ActorPathEdit, place: str, needed: bool = True) -> None:
    """Raise `ScenarioError` for a path of an actor's own that contradicts itself, or that is missing where
    it is ``needed``."""
    given = [name for name in ("pose", "trajectory") if getattr(edit, name) is not None]
    require(needed <= len(given) <= 1, place, "needs pose or trajectory, one of them")
    require(edit.outside is None or edit.trajectory is not None, f"{place}.outside", "needs a trajectory")
    if edit.pose is not None:
        check_rotation(edit.pose, f"{place}.pose")
    if edit.trajectory is not None:
        check_keys(edit.trajectory, f"{place}.trajectory")
    if edit.present is not None and edit.present.start_s is not None and edit.present.end_s is not None:
        start, end = edit.present.start_s, edit.present.end_s
        require(start <= end, f"{place}.present", f"end_s {end} lies before start_s {start}")


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
