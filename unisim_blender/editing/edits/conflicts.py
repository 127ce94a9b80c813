"""Which edits cannot count beside each other."""

from __future__ import annotations

from collections.abc import Iterable

from .lines import EditLine
from .parts import PARTS


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
