"""Objects of one kind by their names: the package's own, and those that other packages bring.

Another distribution brings one by an entry point of the registry's group in its pyproject.toml:

    [project.entry-points."unisim_blender.GROUP"]
    name = "module:object"

Inside Blender an extension is ``bl_ext.<repository>.unisim_blender``. What another package imports as
``unisim_blender.core.data`` has to be the same module there: a second copy would have classes of its own.
"""

from __future__ import annotations

import importlib
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType
from typing import Any, TypeVar

from .errors import UnisimError, in_a_line, short

NAME = "unisim_blender"
HERE = __name__.removesuffix(".core.registry")
"""Name of this package where it runs."""


class OwnName:
    """Finds ``unisim_blender`` and its modules under the name that they have here."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """As importlib asks for it."""
        if name != NAME and not name.startswith(NAME + "."):
            return None
        try:
            module = importlib.import_module(HERE + name.removeprefix(NAME))
        except ModuleNotFoundError as error:
            if error.name == HERE + name.removeprefix(NAME):
                return None
            raise
        return ModuleSpec(name, LoadedModule(module), is_package=hasattr(module, "__path__"))


class LoadedModule(Loader):
    """Gives a module that is loaded already, and leaves it as it was."""

    def __init__(self, module: ModuleType) -> None:
        self._module, self._spec = module, module.__spec__

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """As importlib asks for it."""
        return self._module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module back what importlib has put in."""
        module.__spec__ = self._spec


def answer_to_own_name() -> None:
    """Let ``import unisim_blender`` find this package, once, in place of an earlier version of the extension."""
    if HERE == NAME or OwnName in sys.meta_path:
        return
    for name in [name for name in sys.modules if name == NAME or name.startswith(NAME + ".")]:
        del sys.modules[name]
    sys.meta_path[:] = [OwnName, *(finder for finder in sys.meta_path if not _is_earlier(finder))]


def _is_earlier(finder: object) -> bool:
    return isinstance(finder, type) and finder.__qualname__ == OwnName.__qualname__


def entries(group: str) -> list[EntryPoint]:
    """Return the entry points of a group, by name. What they load may import this package as ``unisim_blender``."""
    points = sorted(entry_points(group=group), key=lambda entry: entry.name)
    if points:
        answer_to_own_name()
    return points


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


MOST_NAMES = 10
"""Largest number of a module's names that the error lists where the module lacks the requested one."""


def named_function(option: str, name: str, argument: str, forms: str = "module:function") -> Callable[..., Any]:
    """Return the function of a name ``module:function`` that a command's option has, also of a module in the working directory.

    ``argument``: what it is a function of; ``forms``: what a name can be. Raises `UnisimError`.
    """
    module, colon, function = name.partition(":")
    if not colon or not module or not function:
        raise UnisimError(f'{option} "{name}": must be {forms}')
    loaded = _module(option, name, module)
    start = getattr(loaded, function, None)
    if start is None:
        own = [
            key
            for key, value in vars(loaded).items()
            if getattr(value, "__module__", None) == module and callable(value)
        ]
        has = f"; it has {', '.join(own[:MOST_NAMES])}" if own else ""
        where = getattr(loaded, "__file__", None) or module
        raise UnisimError(f'{option} "{name}": {where} has no {short(function)}{has}')
    if not callable(start):
        raise UnisimError(
            f'{option} "{name}": {function} must be a function of {argument}, not a {type(start).__name__}'
        )
    function_of_name: Callable[..., Any] = start
    return function_of_name


def _module(option: str, name: str, module: str) -> ModuleType:
    """Import the module of a name, also from the working directory, as ``python -m`` does. Raises `UnisimError`."""
    here = os.getcwd()
    if here not in sys.path and "" not in sys.path:
        sys.path.insert(0, here)
        importlib.invalidate_caches()
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise UnisimError(f'{option} "{name}": {module} imports a module that is absent: {error.name}') from error
        hint = f"; write {module.removesuffix('.py')}:{name.partition(':')[2]}" if module.endswith(".py") else ""
        raise UnisimError(
            f'{option} "{name}": Python finds no module {short(error.name)}, neither in {here} nor where it looks else{hint}'
        ) from error
    except (Exception, SystemExit) as error:
        steps = traceback.extract_tb(error.__traceback__)
        lines = [
            frame
            for frame in steps
            if not frame.filename.startswith("<frozen") and frame.filename != importlib.__file__
        ]
        place = f"{lines[-1].filename}, line {lines[-1].lineno}: " if len(lines) > 1 else ""
        text = in_a_line(Exception(str(error) or type(error).__name__))
        raise UnisimError(f'{option} "{name}": cannot be imported: {place}{type(error).__name__}: {text}') from error
