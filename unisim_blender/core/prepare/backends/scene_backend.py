"""What a backend of trained scenes is, as the registry knows it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ...render.quality import Quality
from ...render.tracer import Backend


class SceneBackend(ABC):
    """Traces rays through trained scenes. What computes is imported where it is first needed."""

    name: str

    @abstractmethod
    def takes(self, device: str, scenes: Iterable[Path]) -> bool:
        """Whether scenes in these folders can be rendered together on a device."""

    @abstractmethod
    def load(self, scene: Path, device: str) -> Any:
        """Load the scene in a folder. Raises `SceneError`."""

    @abstractmethod
    def make(self, scene: Any, quality: Quality, others: Mapping[str, Any]) -> Backend:
        """Return what traces rays through a loaded scene; ``others`` are those that actors are inserted from, by the
        names that appearances have for them."""

    @abstractmethod
    def environment(self) -> dict[str, str]:
        """What equal bytes depend on besides machine, device and numpy. ModuleNotFoundError names what
        is not installed."""
