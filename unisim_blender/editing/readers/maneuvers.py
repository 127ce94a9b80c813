"""Reads the maneuvers of actors, after all other edits of actors and of the ego vehicle: they depend on both."""

from __future__ import annotations

from collections.abc import Iterator

from ...core.scenario.edits import Brake, Cross, CutInManeuver, Duplicate, Follow, Insert, InsertMesh, LaneChange
from ...core.scenario.motion.maneuvers import Maneuver
from ..edits.lines import EditLine, joined, metres, seconds
from ..edits.reader import GroupReader, ReadContext, register
from ..sampled.scene import same
from ..texts import Text, series, translatable
from .actors import ReadEdit, read_edits


@register
class Maneuvers(GroupReader):
    """Reads the maneuvers that `Actors` came upon."""

    group = "ACTOR"
    kinds = ("ACTOR",)
    by_id = True

    def edits(self, reading: ReadContext) -> Iterator[Maneuver]:
        """The maneuvers, those of leaders before those of their followers."""
        left = list(reading.maneuvers)
        while left:
            busy = {edit.actor for edit in left}
            waiting = {edit.actor for edit in left if isinstance(edit, Follow) and edit.leader in busy}
            waiting = waiting if waiting < busy else set()  # leaders in a circle do not wait
            yield from (edit for edit in left if edit.actor not in waiting)
            left = [edit for edit in left if edit.actor in waiting]

    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        yield from (maneuver_line(item) for item in read_edits(reading, uid) if item.maneuvers)


def maneuver_line(item: ReadEdit) -> EditLine:
    """Return the line of an object with maneuvers: how it is there, where it is new, and what it does."""
    words: list[str] = [maneuver_words(maneuver) for maneuver in item.maneuvers]
    edit, context, part, first = item.edit, item.context, "MOVE", ""
    if isinstance(edit, Duplicate):
        part, first = "COPY", Text("Copied")
    elif isinstance(edit, Insert | InsertMesh):
        part, first = ("INSERT", Text("Inserted")) if isinstance(edit, Insert) else ("MESH", Text("Mesh inserted"))
    obj = context.here
    differs = obj.there if context.actor is None or first else ~same(obj.poses, context.raised)
    return context.line(part, joined([first, *words]), edit, differs)


def maneuver_words(maneuver: Maneuver) -> str:
    """Return what an actor does."""
    if isinstance(maneuver, Follow):
        return Text(
            "Follows {leader}, {time:.1f} s and {length} behind",
            leader=maneuver.leader, time=maneuver.gap_s, length=metres(maneuver.gap_m),
        )  # fmt: skip
    if isinstance(maneuver, Brake):
        brakes = Text(
            "Brakes at {value:.1f} m/s² from {time:.1f} s", value=maneuver.deceleration_m_s2, time=maneuver.at_s
        )
        stands_s = maneuver.stands_s
        return (
            brakes if stands_s is None else series([brakes, Text("stands for {duration}", duration=seconds(stands_s))])
        )
    if isinstance(maneuver, LaneChange):
        left = translatable("{length} to the left from {time:.1f} s")
        sentence = left if maneuver.left_m > 0 else translatable("{length} to the right from {time:.1f} s")
        return Text(sentence, length=metres(abs(maneuver.left_m)), time=maneuver.at_s)
    assert isinstance(maneuver, CutInManeuver | Cross)
    gap = Text("{time:.1f} s", time=maneuver.gap_s) if maneuver.gap_s is not None else metres(maneuver.gap_m or 0.0)
    cuts_in, crosses = (
        translatable("Cuts in at {time:.1f} s, {gap} ahead"),
        translatable("Crosses at {time:.1f} s, {gap} ahead"),
    )
    return Text(cuts_in if isinstance(maneuver, CutInManeuver) else crosses, time=maneuver.at_s, gap=gap)
