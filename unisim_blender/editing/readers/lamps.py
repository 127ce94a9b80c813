"""Reads `lamp`: lamps of actors that are set to a state."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...core.scenario.edits import Lamp
from ..edits.lines import EditLine, line_of
from ..edits.reader import GroupReader, ReadContext, register
from ..sampled.clock import Clock
from ..sampled.scene import SampledObject
from ..texts import Text, series, translatable
from .actors import original

DIGITS = 4
"""Of times: Blender's frames of float32 keys tell no more."""
SIDES = translatable("left"), translatable("right")


def lamp_text(name: str) -> Text:
    """Return the name of a lamp in words: its colours, and the side that it is on."""
    if not name:
        return Text("Lamp")
    colours, _, side = name.partition(" ")
    shown = series([Text(colour.capitalize()) for colour in colours.split("-")], "-")
    return series([shown, Text(side)], " ") if side in SIDES else shown


@register
class LampReader(GroupReader):
    """Reads the lamps of actors that are there with an appearance of the log."""

    group = "ACTOR"
    kinds = ("ACTOR",)
    by_id = True

    def edits(self, reading: ReadContext) -> Iterator[Lamp]:
        clock = Clock.of(reading.drive)
        first, last = clock.frames[[0, -1]]
        for actor, lamp, state, begin, end in reading.sampled.lamps:
            if begin < last and end > first and _object_of(actor, reading) is not None:
                from_s, to_s = (round(float(clock.time_s(np.clip(at, first, last))), DIGITS) for at in (begin, end))
                span = None if begin <= first else from_s, None if end >= last else to_s
                yield Lamp(actor, state, lamp or None, *span)

    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        """One line for all lamps of a recorded actor; those of a copy are part of its own line."""
        edits = tuple(edit for edit in self.edits(reading) if edit.actor == uid)
        if edits and (obj := _object_of(uid, reading)) is not None:
            times, shows = reading.clock.times_s, np.zeros(len(reading.clock.times_s), bool)
            for edit in edits:
                shows |= (times >= (edit.from_s or times[0])) & (times < (edit.to_s or np.inf))
            states = dict.fromkeys((edit.lamp or "", edit.state) for edit in edits)
            words = [Text("{lamp}: {state}", lamp=lamp_text(a), state=Text(b.capitalize())) for a, b in states]
            yield line_of("ACTOR", uid, "LAMP", series(words), (obj.title, obj.name), shows, reading.clock, edits)

    def edited_ids(self, reading: ReadContext) -> set[str]:
        return {edit.actor for edit in self.edits(reading)} & set(reading.drive.actors)


def _object_of(actor: str, reading: ReadContext) -> SampledObject | None:
    """Return the object of an actor that is there with an appearance of the log; None where there is none."""
    objects, recorded = list(reading.sampled.of("ACTOR")), reading.drive.actors.get(actor)
    if recorded is None:
        obj = next((obj for obj in objects if obj.title == actor), None)
    else:
        obj = original((obj for obj in objects if obj.uid == actor), recorded, reading.clock)
    return obj if obj is not None and obj.there.any() and not obj.appearance and not obj.mesh else None
