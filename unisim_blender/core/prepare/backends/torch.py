"""Torch: the reference, for every scene and device."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ...render.quality import Quality
from ...render.tracer import Backend
from .scene_backend import SceneBackend


class Torch(SceneBackend):
    """See `SceneBackend`."""

    name = "torch"

    def takes(self, device: str, scenes: Iterable[Path]) -> bool:
        """Whether anything is left that it does not take: no."""
        return True

    def load(self, scene: Path, device: str) -> Any:
        """Load the scene's weights onto the device."""
        from ...model.files.checkpoint import load_scene

        return load_scene(scene, device=device)

    def make(self, scene: Any, quality: Quality, others: Mapping[str, Any]) -> Backend:
        """See `SceneBackend.make`."""
        from ...render.tracers.torch.tracer import TorchBackend

        return TorchBackend(scene, quality, dict(others))

    def environment(self) -> dict[str, str]:
        """Torch's version, and the instruction set that it uses here."""
        import torch

        return {"torch": torch.__version__, "instruction_set": torch.backends.cpu.get_cpu_capability()}
