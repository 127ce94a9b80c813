"""Names of variants, and of their files."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable

from ...core.errors import UnisimError

LONGEST_BYTES = 63
"""What Blender keeps of a name."""


def free_name(wanted: str, taken: Container[str]) -> str:
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


def file_names(names: Iterable[str]) -> list[str]:
    """Return a name of a file or folder for each variant's name, all different whatever the case of letters."""
    taken: set[str] = set()
    found = []
    for name in names:
        plain = re.sub(r'[\\/:*?"<>|\x00-\x1f]', "_", name).strip(". ") or "variant"
        wanted, number = plain, 2
        while wanted.lower() in taken:
            wanted, number = f"{plain} {number}", number + 1
        taken.add(wanted.lower())
        found.append(wanted)
    return found
