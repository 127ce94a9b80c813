"""A line of the edits list: what of a sampled scene is edited, in words, and from when to when.

Readers make the lines of the same edits that a scenario is made of.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import BoolArray
from ..sampled.clock import Clock
from ..sampled.scene import SampledObject
from .parts import OWN_OBJECT, PARTS


@dataclass(frozen=True)
class EditLine:
    """One edit. ``who`` is the object's name as the scenario has it, ``object_name`` as Blender has it, "" where
    it is not there.

    ``frames`` are those at which the edit shows, ``start_s`` and ``end_s`` the times of the first and the last.
    ``edit`` is what the scenario holds. ``muted`` is the number of the muted edit, -1 where it is not muted.
    """

    kind: str
    uid: str
    part: str
    what: str
    who: str
    object_name: str
    start_s: float
    end_s: float
    frames: tuple[int, ...]
    edit: object = None
    muted: int = -1

    @property
    def icon(self) -> str:
        """Name of the icon."""
        return PARTS[self.part].icon_of(self.what)

    @property
    def is_own_object(self) -> bool:
        """Whether the edit is an object of its own: without the edit there is none."""
        return PARTS[self.part].carrier == OWN_OBJECT

    @property
    def key(self) -> tuple[str, str, str]:
        """What tells the edit from the others of a scene, and is the same in every variant."""
        return self.kind, self.who if self.is_own_object else self.uid, self.part


def line_of(
    kind: str, uid: str, part: str, what: str, named: tuple[str, str], shows: BoolArray, clock: Clock, edit: object
) -> EditLine:
    """Return the line of an edit that shows at some of the clock's frames (N,); at all, where at none. ``named`` are
    the names of its object in the scenario and in Blender."""
    at = np.flatnonzero(shows) if shows.any() else np.arange(len(clock.frames))
    frames = tuple(int(frame) for frame in clock.frames[at])
    return EditLine(
        kind, uid, part, what, *named, float(clock.times_s[at[0]]), float(clock.times_s[at[-1]]), frames, edit
    )


def problem_line(kind: str, uid: str, fault: ScenarioError, objects: Iterable[SampledObject]) -> EditLine:
    """Return the line of what keeps a scene from being read."""
    obj = next((obj for obj in objects if f'"{obj.name}"' in str(fault)), None)
    text, title, name = str(fault).split(": ", 1)[-1], "", ""
    if obj is not None:
        title, name = obj.title, obj.name
    return EditLine(kind, uid, "PROBLEM", text[0].upper() + text[1:], title, name, 0.0, 0.0, ())


def nearest_frame(frames: tuple[int, ...], now: int) -> int:
    """Return the frame of some that is nearest to ``now``."""
    return min(frames, key=lambda frame: (abs(frame - now), frame), default=now)
