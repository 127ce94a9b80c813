"""Objects of one kind by their names, for what other packages may add to."""

from __future__ import annotations

from typing import Any, TypeVar

T = TypeVar("T")


class Registry(dict[str, T]):
    """Objects by their names, in the order in which they were registered. ``kind`` is the messages' word for one of them,
    with its article."""

    def __init__(self, kind: str) -> None:
        super().__init__()
        self.kind = kind

    def register(self, item: T) -> T:
        """Add an object by its ``name`` and return it. Raises `ValueError` for a name that is taken."""
        named: Any = item
        self.add(named.name, item)
        return item

    def add(self, name: str, item: T) -> None:
        """Add an object. Raises `ValueError` for a name that is taken."""
        if name in self:
            raise ValueError(f"there is {self.kind} {name!r} already")
        self[name] = item
