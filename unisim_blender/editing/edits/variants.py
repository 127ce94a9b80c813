"""Variants of a scenario: how two differ by their edits, their names, and those of their files."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass, is_dataclass
from typing import Any

from ...core.errors import UnisimError
from .lines import EditLine

SAME = 1e-4
"""Numbers of two edits that differ by less are the same: metres, degrees, parts of quaternions."""


EditLines = tuple[EditLine, ...]
_last: list[tuple[EditLines, EditLines, tuple[Difference, ...]]] = []
"""Last comparison, the two lists and their differences: a panel asks for it whenever it is drawn."""


@dataclass(frozen=True)
class Difference:
    """An edit that two variants do not have alike. ``here`` is the first one's, ``there`` the second one's, None
    where it has none."""

    here: EditLine | None
    there: EditLine | None

    @property
    def line(self) -> EditLine:
        """The edit of the first variant, or else of the second."""
        line = self.here or self.there
        assert line is not None
        return line


def compared(here: EditLines, there: EditLines) -> tuple[Difference, ...]:
    """Return the differences of two lists; of the same two lists as before, what was found then."""
    if not _last or _last[0][0] is not here or _last[0][1] is not there:
        _last[:] = [(here, there, tuple(differences(here, there)))]
    return _last[0][2]


def differences(here: Iterable[EditLine], there: Iterable[EditLine]) -> Iterator[Difference]:
    """Yield what two variants' edits differ in, by object. Muted edits do not count."""
    first, second = (
        {line.key: line for line in lines if line.muted < 0 and line.part != "PROBLEM"} for lines in (here, there)
    )
    for key in sorted({*first, *second}, key=lambda key: ((first.get(key) or second[key]).who, key)):
        a, b = first.get(key), second.get(key)
        if a is None or b is None or not alike(a.edit, b.edit):
            yield Difference(a, b)


def alike(a: Any, b: Any) -> bool:
    """Return whether two values are the same, numbers within `SAME`."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if is_dataclass(a):
        return alike(vars(a), vars(b))
    if isinstance(a, dict):
        return set(a) == set(b) and all(alike(a[name], b[name]) for name in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(alike(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float):
        return abs(a - b) <= SAME
    return bool(a == b)


LONGEST_BYTES = 63
"""Largest length of a name that Blender stores, bytes of UTF-8."""


def free_variant_name(wanted: str, taken: Container[str]) -> str:
    """Return the name ``wanted``, or the next one with a higher number that is not taken: "Variant 2", "Variant 3"."""
    if wanted not in taken:
        return wanted
    stem, number = (match[1], int(match[2])) if (match := re.fullmatch(r"(.*\D)(\d+)", wanted)) else (f"{wanted} ", 1)
    while f"{stem}{number}" in taken:
        number += 1
    return f"{stem}{number}"


def checked_name(name: str, taken: Container[str]) -> None:
    """Raise `UnisimError` where no variant can have this name."""
    if not name.strip():
        raise UnisimError("a variant needs a name")
    if name in taken:
        raise UnisimError(f'"{name}": another scene of this file has this name')
    if len(name.encode()) > LONGEST_BYTES:
        raise UnisimError(f'"{name}": is longer than the {LONGEST_BYTES} bytes that Blender keeps of a name')


def file_names(names: Iterable[str]) -> dict[str, str]:
    """Return a name of a file or folder by each variant's name, all different whatever the case of letters."""
    taken: set[str] = set()
    files = {}
    for name in names:
        plain = re.sub(r'[\\/:*?"<>|\x00-\x1f]', "_", name).strip(". ") or "variant"
        wanted, number = plain, 2
        while wanted.lower() in taken:
            wanted, number = f"{plain} {number}", number + 1
        taken.add(wanted.lower())
        files[name] = wanted
    return files
