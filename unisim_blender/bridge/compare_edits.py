"""Two variants compared by their edits. Nothing here needs Blender."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any

from .edit_lines import Line

SAME = 1e-4
"""Numbers of two edits that differ by less are the same: metres, degrees, parts of quaternions."""


@dataclass(frozen=True)
class Difference:
    """An edit that two variants do not have alike. ``here`` is the first one's, ``there`` the second one's, None
    where it has none."""

    here: Line | None
    there: Line | None

    @property
    def line(self) -> Line:
        """The edit of the first variant, or else of the second."""
        found = self.here or self.there
        assert found is not None
        return found


def differences(here: Iterable[Line], there: Iterable[Line]) -> Iterator[Difference]:
    """Yield what two variants' edits differ in, by object. Muted edits do not count."""
    first, second = ({line.key: line for line in lines if line.muted < 0 and line.part != "PROBLEM"} for lines in (here, there))
    for key in sorted({*first, *second}, key=lambda key: ((first.get(key) or second[key]).who, key)):
        a, b = first.get(key), second.get(key)
        if a is None or b is None or not alike(_plain(a.edit), _plain(b.edit)):
            yield Difference(a, b)


def alike(a: Any, b: Any) -> bool:
    """Return whether two values are the same, numbers within `SAME`."""
    if isinstance(a, dict) and isinstance(b, dict):
        return set(a) == set(b) and all(alike(a[name], b[name]) for name in a)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(alike(one, other) for one, other in zip(a, b, strict=True))
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) <= SAME
    return bool(a == b)


def _plain(edit: object) -> Any:
    return asdict(edit) if is_dataclass(edit) and not isinstance(edit, type) else edit
