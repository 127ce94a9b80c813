"""Entry points of other packages."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

from .own_name import answer_to_own_name


def entries(group: str) -> list[EntryPoint]:
    """Return the entry points of a group, by name. What they load may import this package as ``unisim_blender``."""
    found = sorted(entry_points(group=group), key=lambda entry: entry.name)
    if found:
        answer_to_own_name()
    return found
