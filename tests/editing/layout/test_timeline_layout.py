"""The presence timeline's layout: where rows and bars lie, what a click hits, what is drawn."""

from __future__ import annotations

import numpy as np
import pytest
from list_entries import entry

from unisim_blender.editing.layout import timeline
from unisim_blender.editing.layout.overlays import Rectangle
from unisim_blender.editing.layout.timeline import fitting_rows, lay_out, scrolled, size_of

ROOM = Rectangle(68.0, 36.0, 952.0, 276.0)


def test_rows_that_fit_are_shown_and_scrolled() -> None:
    many = [entry(f"Car {number}") for number in range(100)]
    found = lay_out(ROOM, 1.0, many, 0, 0.0, 8.0)
    assert found is not None and len(found.rows) == fitting_rows(ROOM, 1.0) == 12 and found.top <= ROOM.top
    down = lay_out(ROOM, 1.0, many, 95, 0.0, 8.0)
    assert down is not None and down.rows[-1].name == "Car 99" and len(down.rows) == len(found.rows)
    few = lay_out(ROOM, 1.0, many[:3], 50, 0.0, 8.0)
    assert few is not None and [row.name for row in few.rows] == ["Car 0", "Car 1", "Car 2"] and few.top < found.top
    assert scrolled(3, -9, 100, 10) == 0 and scrolled(3, 99, 100, 10) == 90 and scrolled(0, 3, 5, 10) == 0


def test_a_rectangle_of_its_height_holds_all_rows() -> None:
    for count, scale in ((1, 1.0), (7, 1.5), (20, 2.0)):
        width, height = size_of(count)
        box, entries = Rectangle(0, 0, width * scale, height * scale), [entry("Car")] * count
        found = lay_out(box, scale, entries, 0, 0.0, 8.0)
        assert fitting_rows(box, scale) == count and found is not None and found.top <= box.top


def test_no_room_no_timeline() -> None:
    assert lay_out(Rectangle(0, 0, 200, 300), 1.0, [entry("Car 1")], 0, 0.0, 8.0) is None
    assert lay_out(Rectangle(0, 0, 900, 40), 1.0, [entry("Car 1")], 0, 0.0, 8.0) is None
    assert lay_out(ROOM, 1.0, [entry("Car 1")], 0, 3.0, 3.0) is None
    assert lay_out(ROOM, 1.0, [], 0, 0.0, 8.0) is not None


def test_places_and_times_belong_to_each_other() -> None:
    one = entry("Car 1", steps=np.array([[1.0, 2.0], [4.0, 4.0]]))
    found = lay_out(ROOM, 1.0, [one, entry("Cone 1")], 0, 0.0, 8.0)
    assert found is not None
    for time_s in (0.0, 1.7, 8.0):
        assert found.time_at(found.x_of(time_s)) == pytest.approx(time_s)
    assert found.time_at(0.0) == 0.0 and found.time_at(2000.0) == 8.0
    (left, right), (short_left, short_right) = found.bars(one)
    assert (left, right) == pytest.approx((found.x_of(1.0), found.x_of(2.0))) and short_right - short_left >= 3.0
    middle = found.row_bottom(0) + found.row_px / 2
    hit = found.hit(found.x_of(1.5), middle)
    assert hit is not None and hit[0] is one and hit[1] == pytest.approx(1.5)
    beside = found.hit(found.x_of(2.4), middle)  # the nearest time at which it is there
    assert beside is not None and beside[1] == pytest.approx(2.0)
    name = found.hit(found.left + 5, middle)
    assert name is not None and name[1] == pytest.approx(1.0)
    second = found.hit(found.x_of(0.5), found.row_bottom(1) + 2)
    assert second is not None and second[0].name == "Cone 1"
    assert found.hit(found.x_of(0.5), found.rows_top + 3) is None and found.hit(found.right + 20, middle) is None
    assert found.covers(found.left + 1, found.top - 1) and not found.covers(found.left + 1, found.top + 1)


def test_ticks_are_round_and_far_enough_apart() -> None:
    for end_s, step in ((1.9, 0.2), (8.0, 1.0), (60.0, 5.0)):
        found = lay_out(ROOM, 1.0, [entry("Car 1")], 0, 0.0, end_s)
        assert found is not None
        ticks = found.ticks()
        assert ticks[0] == 0.0 and np.allclose(np.diff(ticks), step) and ticks[-1] <= end_s


def test_bars_have_the_class_colour_and_edited_ones_a_rim() -> None:
    found = lay_out(
        ROOM, 1.0, [entry("Car 1", edited=True), entry("Cone 1", label="Cones", group="OTHER")], 0, 0.0, 8.0
    )
    assert found is not None
    corners, colours = timeline.shapes_of(found, 3.0, None, 1.0, lambda text: 6.0 * len(text)).arrays()
    assert corners.shape == (len(colours), 3) and len(colours) % 6 == 0
    known = {tuple(colour) for colour in colours.round(4).tolist()}
    for row in found.rows:
        assert tuple(np.array(timeline.colour_of(row), np.float32).round(4).tolist()) in known
    assert timeline.colour_of(found.rows[0]) != timeline.colour_of(found.rows[1])
    rims = [i for i in range(0, len(colours), 6) if tuple(colours[i]) == timeline.EDITED]
    assert len(rims) == 1 and corners[rims[0]][1] < found.rows_top and corners[rims[0]][1] >= found.row_bottom(0)
    now = [i for i in range(0, len(colours), 6) if np.allclose(colours[i], timeline.NOW)]
    assert corners[now[0] : now[0] + 6, 0].mean() == pytest.approx(found.x_of(3.0), abs=0.5)
