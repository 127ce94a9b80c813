"""The compiled kernels: on the CPU, without torch, for the shapes that they take."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from ... import native
from ...model.config import ModelConfig
from ...model.files.scene_file import read_scene_header
from ...render.quality import Quality
from ...render.tracer import Backend
from ...render.tracers.compiled.scene import CompiledScene
from ...render.tracers.compiled.support import not_taken
from ...render.tracers.compiled.tracer import CompiledBackend
from ..scenes import stamp
from .scene_backend import SceneBackend


class Compiled(SceneBackend):
    """See `SceneBackend`."""

    name = "compiled"

    def takes(self, device: str, scenes: Iterable[Path]) -> bool:
        """Whether the kernels were built, and take all the scenes."""
        return (
            device == "cpu" and native.library() is not None and not any(_not_taken(stamp(scene)) for scene in scenes)
        )

    def load(self, scene: Path, device: str) -> CompiledScene:
        """Map the scene's weights."""
        return CompiledScene(scene)

    def make(self, scene: CompiledScene, quality: Quality, others: Mapping[str, CompiledScene]) -> Backend:
        """See `SceneBackend.make`."""
        return CompiledBackend(scene, quality, dict(others))

    def environment(self) -> dict[str, str]:
        """The kernels' version, and the instruction set that they use here."""
        return {"kernels": str(native.ABI_VERSION), "instruction_set": native.variant()}


@lru_cache(maxsize=64)
def _not_taken(stamped: tuple[Any, ...]) -> str:
    """`not_taken` of the scene that a stamp is of: the header need not be read for every image of a view."""
    return not_taken(ModelConfig.from_dict(read_scene_header(stamped[0]).model))
