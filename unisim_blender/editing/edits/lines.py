"""A line of the edits list: what of a sampled scene is edited, in words, and from when to when; and the parts of objects
that lines tell of.

Readers make the lines of the same edits that a scenario is made of.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import BoolArray
from ..sampled.clock import Clock
from ..sampled.scene import SampledObject

OWN_OBJECT, PLACE = "own_object", "place"
"""Carriers of an edit: an object that would not be there without it; where an object of the drive is, and
whether it is there."""


@dataclass(frozen=True)
class EditPart:
    """A part by its name, which files keep. ``icons`` are those of lines that begin with a word.

    ``carrier`` is the module of `bridge/changes/carriers` that mutes, unmutes and takes back its edits; "" where
    nothing can be. ``is_absence``: whether the object is gone, so that none of its other edits counts beside.
    """

    name: str
    icon: str
    carrier: str = PLACE
    is_absence: bool = False
    icons: Mapping[str, str] = field(default_factory=dict)

    def icon_of(self, words: str) -> str:
        """Name of the icon of a line."""
        return next((icon for word, icon in self.icons.items() if words.startswith(word)), self.icon)


PARTS = {
    part.name: part
    for part in (
        EditPart("REMOVE", "TRASH", is_absence=True),
        EditPart("APPEARANCE", "SHADING_TEXTURE", "appearance"),
        EditPart("MOVE", "ORIENTATION_GLOBAL", icons={"Retimed": "TIME"}),
        EditPart("COPY", "DUPLICATE", OWN_OBJECT),
        EditPart("INSERT", "ADD", OWN_OBJECT),
        EditPart("MESH", "MESH_MONKEY", OWN_OBJECT),
        EditPart("SCALE", "FULLSCREEN_ENTER", "scale"),
        EditPart("BODY", "AUTO", OWN_OBJECT),
        EditPart("SENSOR", "CAMERA_DATA"),
        EditPart("EGO", "AUTO"),
        EditPart("PROBLEM", "ERROR", ""),
    )
}
"""The parts by their names. A reader may add one of its own."""


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
        """Key that distinguishes the edit from the others of a scene, and is the same in every variant."""
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


def conflicting(line: EditLine, lines: Iterable[EditLine]) -> list[EditLine]:
    """Return the edits that count and cannot stand beside a muted one: an actor has one trajectory, one appearance,
    or is gone."""
    if line.is_own_object:
        return []
    part = PARTS[line.part]
    own = [
        one
        for one in lines
        if one.muted < 0
        and not one.is_own_object
        and one.part != "PROBLEM"
        and (one.kind, one.uid) == (line.kind, line.uid)
    ]
    if part.is_absence:
        return own
    # what is carried by the same, and an absence
    return [one for one in own if PARTS[one.part].carrier == part.carrier or PARTS[one.part].is_absence]
