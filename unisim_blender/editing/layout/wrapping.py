"""Texts in rows that have room for them, and texts cut short."""

from __future__ import annotations

from collections.abc import Callable


def wrapped(text: str, first: float, rest: float, width_of: Callable[[str], float]) -> list[str]:
    """Return a text in rows, the first no wider than ``first`` and the others than ``rest``, as ``width_of``
    measures them.

    Rows end between words, or in a word that is too long for any row; all rows together are the text.
    """
    rows, room = [], first
    while width_of(text) > room and len(text) > 1:
        count = _fitting(text, room, width_of)
        space = text.rfind(" ", 1, count + 1)
        cut = space if space > 0 else count
        rows.append(text[:cut])
        text, room = text[cut:].lstrip(" "), rest
    return [*rows, text]


def _fitting(text: str, room: float, width_of: Callable[[str], float]) -> int:
    """Return how many characters of a text have room, at least one."""
    low, high = 1, len(text)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if width_of(text[:middle]) <= room else (low, middle - 1)
    return low


def shortened(text: str, width: float, width_of: Callable[[str], float]) -> str:
    """Return a text, its end replaced by "…" where it is wider than ``width``."""
    if width_of(text) <= width:
        return text
    while len(text) > 1 and width_of(text + "…") > width:
        text = text[:-1]
    return text + "…"
