"""Edits of one object that cannot count beside each other, and beam tables that people write."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unisim_blender.core.errors import UnisimError
from unisim_blender.editing.edits.lines import EditLine, conflicting
from unisim_blender.editing.sensors.mounts import own_table

MOVE = EditLine("ACTOR", "car-1", "MOVE", "Moved", "Car 1", "Car 1", 0.0, 1.0, (0, 1))


def test_an_actor_has_one_trajectory_one_appearance_or_is_gone() -> None:
    parts = ("MOVE", "APPEARANCE", "SCALE", "REMOVE", "COPY", "PROBLEM")
    lines = [replace(MOVE, part=part) for part in parts] + [replace(MOVE, uid="car-2"), replace(MOVE, muted=3)]

    def beside(part: str) -> set[str]:
        return {line.part for line in conflicting(replace(MOVE, part=part, muted=0), lines)}

    assert beside("MOVE") == {"MOVE", "REMOVE"} and beside("APPEARANCE") == {"APPEARANCE", "REMOVE"}
    assert beside("REMOVE") == {"MOVE", "APPEARANCE", "SCALE", "REMOVE"} and beside("COPY") == set()
    assert all(line.uid == "car-1" and line.muted < 0 for line in conflicting(replace(MOVE, muted=0), lines))


def test_a_beam_table_is_sorted_from_the_top() -> None:
    model = own_table("-10, 5,0.5,", 900, 80.0)
    assert np.degrees(model.elevation_rad) == pytest.approx([5.0, 0.5, -10.0])
    assert (model.columns, model.max_range_m, model.beams) == (900, 80.0, 3)
    for wrong, text in (("1, two", "are not numbers"), (" , ", "at least one"), ("0, 91", "between -90 and 90")):
        with pytest.raises(UnisimError, match=text):
            own_table(wrong, 900, 80.0)
