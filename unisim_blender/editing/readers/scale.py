"""Reads `scale`: an actor that is drawn larger or smaller than it was imported."""

from __future__ import annotations

from ...core.scenario.edits import Scale
from ..edits.lines import EditLine, line_of
from ..edits.reader import ActorReader, Standing, register
from ..sampled.scaling import UNIT, scale_text
from ..texts import Text


@register
class ScaleReader(ActorReader[Scale]):
    """Reads sizes, also those of new actors."""

    def read(self, standing: Standing) -> Scale | None:
        """The object's factors."""
        return self.read_new(standing.known.uid, standing)

    def read_new(self, new: str, standing: Standing) -> Scale | None:
        """The object's factors."""
        factors = standing.here.scaling.factors
        return Scale(new, factors) if factors != UNIT else None

    def line(self, edit: Scale, standing: Standing) -> EditLine:
        """By how much."""
        words, there = Text("Scaled by {factors}", factors=scale_text(edit.factors)), standing.here.there
        return line_of("ACTOR", edit.actor, "SCALE", words, standing.names, there, standing.clock, edit)
