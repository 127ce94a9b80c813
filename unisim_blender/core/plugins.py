"""Entry points of other packages, which import this one by its own name.

Inside Blender an extension is ``bl_ext.<repository>.unisim_blender``. What another package imports as
``unisim_blender.core.data`` has to be the same module there: a second copy would have classes of its own.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType

NAME = "unisim_blender"
HERE = __name__.removesuffix(".core.plugins")
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
    found = sorted(entry_points(group=group), key=lambda entry: entry.name)
    if found:
        answer_to_own_name()
    return found
