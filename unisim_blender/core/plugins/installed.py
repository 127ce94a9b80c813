"""Objects that other packages register by entry points, each checked and warned of by itself."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Sequence
from importlib.metadata import EntryPoint
from typing import Any

from ..errors import in_a_line
from .entries import entries


def load_installed(
    group: str,
    kind: str,
    known: Collection[str],
    members: Sequence[str],
    check: Callable[[Any], None] = lambda loaded: None,
) -> tuple[Any, ...]:
    """Return what other packages register in a group of entry points.

    What lacks one of ``members``, has a name that is ``known`` or taken, cannot be loaded, or what ``check`` raises
    anything for is left out, with a warning that calls it a ``kind``.
    """
    found: dict[str, Any] = {}
    for entry in entries(group):
        try:
            loaded = entry.load()
            for member in members:
                if not hasattr(loaded, member):
                    raise TypeError(f"{entry.value} has no {member!r}")
            if loaded.name in known or loaded.name in found:
                raise ValueError(f"there is a {kind} {loaded.name!r} already")
            check(loaded)
        except Exception as error:  # noqa: BLE001  another package's code may raise anything, and the others still work
            about = f"{type(error).__name__}: {in_a_line(error)}"
            # told of the line that asked for what is installed
            warnings.warn(f"the {kind} {entry.name!r} of {_distribution(entry)} is left out: {about}", stacklevel=4)
        else:
            found[loaded.name] = loaded
    return tuple(found.values())


def _distribution(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else entry.value
