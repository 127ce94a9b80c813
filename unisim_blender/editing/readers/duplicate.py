"""Reads `duplicate`: a copy of a recorded actor's object."""

from __future__ import annotations

import numpy as np

from ...core.scenario.edits import Duplicate
from ..edits.lines import EditLine, line_of
from ..edits.path_words import path_phrases
from ..edits.reader import NewActorReader, Standing, register
from ..edits.trajectories import present, vector
from ..edits.words import joined, unmoved
from ..sampled.poses import SAME_M, same_turn
from ..texts import LOWER, Text, cased


@register
class DuplicateReader(NewActorReader[Duplicate]):
    """Reads copies with their source's appearance."""

    def reads(self, standing: Standing) -> bool:
        """One with another appearance is an inserted actor."""
        return standing.actor is not None and not standing.here.appearance

    def read(self, standing: Standing) -> Duplicate:
        """A copy that is displaced alike at all frames, in the world's axes or its own, keeps the actor's own
        trajectory between frames too."""
        obj, actor, base, there = standing.here, standing.known, standing.recorded, standing.recorded_there
        uid = standing.reading.new_id(obj)
        changed = bool((obj.there != there).any())
        at = obj.there & there
        apart = (obj.poses - base)[at, :3, 3]
        if not changed and same_turn(obj.poses, base)[at].all():
            if (np.ptp(apart, axis=0) <= 2 * SAME_M).all():
                return Duplicate(actor.uid, uid, world_offset_m=vector(apart.mean(0)))
            beside = np.einsum("nji,nj->ni", base[at, :3, :3], apart)
            if (np.ptp(beside, axis=0) <= 2 * SAME_M).all():
                return Duplicate(actor.uid, uid, offset_m=vector(beside.mean(0)))
        return Duplicate(
            actor.uid, uid, **standing.path(), present=present(standing.clock, obj.there) if changed else None
        )

    def line(self, edit: Duplicate, standing: Standing) -> EditLine:
        """Where the copy is, beside the recorded actor."""
        obj, base = standing.here, standing.recorded
        words = path_phrases(obj, base, standing.raised, standing.recorded_there, standing.known, standing.clock)
        words[:1] = [unmoved(phrase) for phrase in words[:1]]
        what = Text("Copied: {how}", how=cased(joined(words), LOWER)) if words else Text("Copied, in place")
        return line_of("ACTOR", obj.uid, "COPY", what, standing.names, obj.there, standing.clock, edit)
