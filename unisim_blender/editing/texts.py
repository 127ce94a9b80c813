"""Texts for people that are put together of a sentence and values, so that they can be said in other languages, too.

A `Text` is the English string. `translated` returns it in another language, whose sentences are looked up by the
English ones, with names in braces.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Container, Mapping, Sequence
from itertools import count


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


def free_name(wanted: str, taken: Container[str], between: str = " ") -> str:
    """Return ``wanted``, or that name with the lowest number from 2 on behind it that is not taken."""
    names = (wanted if number == 1 else f"{wanted}{between}{number}" for number in count(1))
    return next(name for name in names if name not in taken)


LOWER, UPPER = "lower", "upper"


class Text(str):
    """A sentence or a part of one, in English: ``template`` with ``values`` in its braces. Values may be texts
    themselves.

    ``case`` is what its first letter is made in every language: "" for as it is, `LOWER` or `UPPER`.
    """

    template: str
    values: Mapping[str, object]
    case: str

    def __new__(cls, template: str, /, **values: object) -> Text:
        """Put a text together."""
        return text_of(template, values)

    def __reduce__(self) -> tuple[object, ...]:
        """Copy and pickle it by its parts."""
        return text_of, (self.template, dict(self.values), self.case)


def text_of(template: str, values: Mapping[str, object], case: str = "") -> Text:
    """Return a text by its parts."""
    new = str.__new__(Text, _said(template, values, case, str))
    new.template, new.values, new.case = template, values, case
    return new


def translated(text: str, translate: Callable[[str], str]) -> str:
    """Return a text in another language, as ``translate`` has its sentences; a string that is no `Text` as it is."""
    return _said(text.template, text.values, text.case, translate) if isinstance(text, Text) else text


def _said(template: str, values: Mapping[str, object], case: str, translate: Callable[[str], str]) -> str:
    known = {name: translated(value, translate) if isinstance(value, str) else value for name, value in values.items()}
    said = translate(template).format(**known)
    return said[:1].lower() + said[1:] if case == LOWER else said[:1].upper() + said[1:] if case == UPPER else said


def cased(text: str, case: str) -> Text:
    """Return a text with its first letter made small (`LOWER`) or large (`UPPER`)."""
    return (
        text_of(text.template, text.values, case) if isinstance(text, Text) else text_of("{text}", {"text": text}, case)
    )


def series(parts: Sequence[str], between: str = ", ") -> Text:
    """Return texts as one."""
    names = [f"part{number}" for number in range(len(parts))]
    return text_of(between.join(f"{{{name}}}" for name in names), dict(zip(names, parts, strict=True)))


def counted(number: int, singular: str, plural: str) -> Text:
    """Return a number and what it counts: ``one`` where it is one, else ``many``, which has {count} in it."""
    return text_of(singular if number == 1 else plural, {"count": number})


def kmh(speed_m_s: float) -> str:
    """Return a speed, "36 km/h"; a dash for NaN."""
    return f"{3.6 * speed_m_s:.0f} km/h" if math.isfinite(speed_m_s) else "–"


def clock_text(seconds: float) -> str:
    """Return a duration, "1:05"."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def translatable(template: str) -> str:
    """Return a sentence that a `Text` is made of elsewhere, as it is: the call says that it has to be translated."""
    return template


def packed(text: str) -> str:
    """Return the parts of a text as JSON, "" for a string that is no `Text`."""
    return json.dumps(_parts(text), ensure_ascii=False) if isinstance(text, Text) else ""


def unpacked(parts: str, plain: str) -> str:
    """Return the text that was packed; ``plain`` where nothing was, as in files of earlier versions, or where that is
    not it."""
    try:
        new = _whole(json.loads(parts)) if parts else plain
    except (ValueError, LookupError, TypeError, AttributeError):
        return plain
    return new if isinstance(new, str) and new == plain else plain


def _parts(value: object) -> object:
    if isinstance(value, Text):
        return {
            "text": value.template,
            "values": {name: _parts(item) for name, item in value.values.items()},
            "case": value.case,
        }
    return value if isinstance(value, str | int) else float(value)  # type: ignore[arg-type]


def _whole(value: object) -> object:
    if not isinstance(value, dict):
        return value
    return text_of(value["text"], {name: _whole(item) for name, item in value["values"].items()}, value["case"])
