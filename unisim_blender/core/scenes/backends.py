"""Backends of trained scenes, by scene and device: the compiled kernels where they take all of them, or else torch.

The kernels render on the CPU, without torch, the shapes that they support; torch is the reference, for every scene and
device.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .. import native
from ..render.quality import quality_named
from ..render.tracer import Backend
from ..render.tracers.compiled.scene import CompiledScene, not_taken
from ..render.tracers.compiled.tracer import CompiledBackend
from .scene import Scene

Loaded = dict[tuple[str, str, Scene], Any]
"""Scenes that are loaded, by what computes them, device, and scene."""
KERNELS, TORCH = "compiled", "torch"


def backend_name(device: str, scenes: Sequence[Scene] = ()) -> str:
    """Return what computes scenes together on a device: `KERNELS` or `TORCH`. Raises `SceneError`."""
    kernels = device == "cpu" and native.library() is not None
    return KERNELS if kernels and not any(not_taken(scene.config) for scene in scenes) else TORCH


def environment(device: str, scenes: Sequence[Scene] = ()) -> dict[str, str]:
    """Return what else equal bytes depend on: machine, instruction set, libraries that compute. ModuleNotFoundError names the
    one that is not installed."""
    common = {"machine": platform.machine(), "device": device, "numpy": np.__version__}
    if backend_name(device, scenes) == KERNELS:
        return {**common, "kernels": str(native.ABI_VERSION), "instruction_set": native.variant()}
    import torch

    return {**common, "torch": torch.__version__, "instruction_set": torch.backends.cpu.get_cpu_capability()}


def load_backend(
    scene: Scene,
    others: Mapping[str, Scene] | None = None,
    quality: str = "balanced",
    device: str = "cpu",
    loaded: Loaded | None = None,
) -> Backend:
    """Load a scene onto a device, and those that actors are inserted from, by the names that appearances have for them.

    ``loaded`` holds the scenes that an earlier call has loaded, and afterwards those of this one. Raises `SceneError`.
    """
    every = {"": scene, **(others or {})}
    name = backend_name(device, tuple(every.values()))
    before, now, scenes = loaded or {}, Loaded(), {}
    for known_as, one in every.items():
        key = name, device, one
        scenes[known_as] = now[key] = before.get(key) or _load(name, one, device)
    if loaded is not None:
        loaded.clear()
        loaded.update(now)
    own, of_quality = scenes.pop(""), quality_named(quality)
    if name == KERNELS:
        return CompiledBackend(own, of_quality, scenes)
    from ..render.tracers.torch.tracer import TorchBackend

    return TorchBackend(own, of_quality, scenes)


def _load(name: str, scene: Scene, device: str) -> Any:
    if name == KERNELS:
        return CompiledScene(scene.path, header=scene.header)
    from ..model.files.checkpoint import load_scene

    return load_scene(scene.path, device, scene.header)
