"""Objects of one kind by their names: the package's own, and those that other packages bring.

Another distribution brings one by an entry point of the registry's group in its pyproject.toml:

    [project.entry-points."unisim_blender.GROUP"]
    name = "module:object"
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint
from typing import Any, TypeVar

from .errors import in_a_line
from .plugins import entries

T = TypeVar("T")


class Registry(dict[str, T]):
    """The package's own objects by their names, in the order in which they were registered.

    ``kind`` is the messages' word for one of them, with its article; ``group`` is that of the entry points by which other
    packages bring more. An object has the attributes ``members``, and its name in ``key``; ``check`` raises anything for one
    that cannot be used.
    """

    def __init__(
        self,
        kind: str,
        group: str = "",
        members: Sequence[str] = (),
        check: Callable[[Any], object] = lambda item: None,
        key: str = "name",
    ) -> None:
        super().__init__()
        self.kind, self.group, self.members, self.check, self.key = kind, group, members, check, key
        self._plugins: dict[str, T] | None = None

    def register(self, item: T) -> T:
        """Add an object by its name and return it: a decorator, too. Raises `ValueError` for a name that another one has."""
        self.add(self._checked_name(item), item)
        return item

    def add(self, name: str, item: T) -> None:
        """Add an object. Raises `ValueError` for a name that another one has."""
        if self.get(name, item) is not item:
            raise ValueError(f"there is {self.kind} {name!r} already")
        self[name] = item

    def with_plugins(self) -> dict[str, T]:
        """Return the package's own objects, then those of other packages, by their names.

        The latter are loaded once. One that lacks a member, has a name that is taken, or cannot be loaded or used is left out
        with a warning.
        """
        if self._plugins is None:
            self._plugins = {}
            for entry in entries(self.group) if self.group else ():
                self._load(entry, self._plugins)
        return {**self, **self._plugins}

    def forget_plugins(self) -> None:
        """Load other packages' objects again where they are next asked for."""
        self._plugins = None

    def _load(self, entry: EntryPoint, plugins: dict[str, T]) -> None:
        try:
            item = entry.load()
            name = self._checked_name(item, entry.value)
            if name in self or name in plugins:
                raise ValueError(f"there is {self.kind} {name!r} already")
            plugins[name] = item
        except Exception as error:  # noqa: BLE001  another package's code may raise anything, and the others still work
            distribution = entry.dist.name if entry.dist is not None else entry.value
            about = f"{type(error).__name__}: {in_a_line(error)}"
            kind = self.kind.partition(" ")[2]
            # warned of at the line that asked for what is installed
            warnings.warn(f"the {kind} {entry.name!r} of {distribution} is left out: {about}", stacklevel=4)

    def _checked_name(self, item: Any, shown: str | None = None) -> str:
        for member in self.members:
            if not hasattr(item, member):
                raise TypeError(f"{shown or item!r} has no {member!r}")
        self.check(item)
        return str(getattr(item, self.key))
