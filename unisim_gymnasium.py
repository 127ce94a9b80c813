"""Registers the environment ``UniSim-v0`` with Gymnasium as a program imports Gymnasium.

From 1.0 on Gymnasium loads no entry points. ``unisim_blender.pth``, which is installed beside the package, imports this module
as Python starts. It imports nothing but what Python has loaded by then, the package neither, and waits for
``gymnasium.envs``.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # typing's takes longer to import than all of this
if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType
    from typing import Any

AWAITED = "gymnasium.envs"
NAME = "UniSim-v0"
ENTRY_POINT = "unisim_blender.core.simulation.environment:UniSimEnv"


def register() -> None:
    """Register the environment; needs Gymnasium's own modules to be imported."""
    registration: Any = sys.modules[f"{AWAITED}.registration"]
    if NAME not in registration.registry:
        registration.register(NAME, entry_point=ENTRY_POINT)


class _Finder:
    """Finds ``gymnasium.envs`` as the other finders do, once, with a loader that registers behind it."""

    @classmethod
    def find_spec(
        cls, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """As importlib asks for it."""
        if name != AWAITED:
            return None
        sys.meta_path.remove(cls)
        others = (finder.find_spec(name, path, target) for finder in list(sys.meta_path))
        spec = next((one for one in others if one is not None), None)
        if spec is not None and spec.loader is not None:
            own: Any = _Loader(spec.loader)
            spec.loader = own
        return spec


class _Loader:
    """A module's own loader, after which the environment is registered."""

    def __init__(self, own: Any) -> None:
        self._own = own

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """As importlib asks for it."""
        found: ModuleType | None = self._own.create_module(spec)
        return found

    def exec_module(self, module: ModuleType) -> None:
        """As importlib asks for it."""
        assert module.__spec__ is not None
        module.__loader__ = module.__spec__.loader = self._own
        self._own.exec_module(module)
        try:
            register()
        except Exception:  # noqa: BLE001  another Gymnasium than is known still has to be imported
            pass


def wait() -> None:
    """Register as soon as Gymnasium is imported, or now where it is."""
    if f"{AWAITED}.registration" in sys.modules:
        register()
    elif _Finder not in sys.meta_path:
        sys.meta_path.insert(0, _Finder)


wait()
