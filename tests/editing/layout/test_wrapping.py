"""Texts in rows, and cut short, measured by their letters."""

from __future__ import annotations

from unisim_blender.editing.texts import shortened, wrapped


def test_rows_end_between_words() -> None:
    assert wrapped("moved to the left", 8, 6, len) == ["moved to", "the", "left"]
    assert wrapped("fits", 8, 6, len) == ["fits"]


def test_a_word_that_is_too_long_is_cut() -> None:
    rows = wrapped("Geschwindigkeit", 6, 4, len)
    assert "".join(rows) == "Geschwindigkeit" and [len(row) for row in rows] == [6, 4, 4, 1]


def test_what_is_too_wide_loses_its_end() -> None:
    assert shortened("car-01", 6, len) == "car-01"
    assert shortened("car-01 *", 6, len) == "car-0…"
    assert shortened("car-01", 0, len) == "c…", "one letter stays"
