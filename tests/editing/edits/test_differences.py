"""Differences of two lists of edits."""

from __future__ import annotations

from unisim_blender.editing.edits.lines import EditLine
from unisim_blender.editing.edits.variants import alike, compared, differences


def test_differences() -> None:
    def line(uid: str, what: str, edit: object, muted: int = -1) -> EditLine:
        return EditLine("ACTOR", uid, "MOVE", what, uid, uid, 0.0, 1.0, (0, 1), edit, muted)

    here = (line("a", "1", [1.0, 2.0]), line("b", "1", [1.0]), line("c", "1", [1.0]), line("d", "1", [3.0], muted=0))
    there = (line("a", "1", [1.00001, 2.0]), line("b", "2", [2.0]), line("d", "1", [3.0]))
    found = list(differences(here, there))
    assert [(one.line.uid, one.here is not None, one.there is not None) for one in found] == [
        ("b", True, True), ("c", True, False), ("d", False, True),
    ]  # fmt: skip
    assert compared(here, there) is compared(here, there) and list(compared(here, there)) == found
    assert list(compared(here, here)) == []
    assert not alike({"a": 1}, {"b": 1}) and not alike([1.0], [1.0, 2.0]) and alike(("x", None), ("x", None))
