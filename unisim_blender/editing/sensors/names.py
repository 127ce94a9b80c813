"""Names of sensors that no other one has, and names of rig presets."""

from __future__ import annotations

from collections.abc import Container

from ...core.errors import ScenarioError

LONGEST_NAME = 60
"""Letters of a rig preset's name."""


def free_name(wanted: str, taken: Container[str]) -> str:
    """Return ``wanted``, or that name with a number behind it that is not taken."""
    name, number = wanted, 2
    while name in taken:
        name, number = f"{wanted}_{number}", number + 1
    return name


def preset_name(name: str) -> str:
    """Return a rig preset's name without spaces around it. Raises `ScenarioError` where no file can have it."""
    name = name.strip()
    odd = sorted({letter for letter in name if not (letter.isalnum() or letter in " _-.()+")})
    if not name or name.startswith(".") or len(name) > LONGEST_NAME or odd:
        raise ScenarioError(
            f'name "{name}": a preset\'s name has 1 to {LONGEST_NAME} letters, digits, spaces and _-.()+ and begins with no dot'
        )
    return name
