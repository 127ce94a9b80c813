"""Which edits cannot count beside each other."""

from __future__ import annotations

from collections.abc import Iterable

from .lines import ADDED, Line


def conflicting(line: Line, lines: Iterable[Line]) -> list[Line]:
    """Return the edits that count and cannot stand beside a muted one: an actor has one trajectory, one appearance,
    or is gone."""
    if line.part in ADDED:
        return []
    own = [
        one
        for one in lines
        if one.muted < 0 and one.part not in (*ADDED, "PROBLEM") and (one.kind, one.uid) == (line.kind, line.uid)
    ]
    alone = ("APPEARANCE", "SCALE")
    apart = set(alone) if line.part != "REMOVE" else set()
    if line.part in alone:
        return [one for one in own if one.part in (line.part, "REMOVE")]
    return [one for one in own if one.part not in apart]
