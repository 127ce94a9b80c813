"""Backends of trained scenes, the fastest first: the first that takes device and scenes renders them. Another one is a
file in this folder and a line here."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ...render.quality import quality_named
from ...render.tracer import Backend
from ..scenes import stamp
from .compiled import Compiled
from .scene_backend import SceneBackend
from .torch import Torch

BACKENDS: list[SceneBackend] = [Compiled(), Torch()]


def backend_for(device: str, scenes: Iterable[Path] = ()) -> SceneBackend:
    """Return the backend that renders the scenes in folders on a device. Raises `SceneError`."""
    paths = tuple(scenes)
    return next(backend for backend in BACKENDS if backend.takes(device, paths))


def environment(device: str, scenes: Iterable[Path] = ()) -> dict[str, str]:
    """What else equal bytes depend on: machine, instruction set, libraries that compute. ModuleNotFoundError names the
    one that is not installed."""
    common = {"machine": platform.machine(), "device": device, "numpy": np.__version__}
    return {**common, **backend_for(device, scenes).environment()}


def make_backend(
    scene_path: Path,
    others: Iterable[str] = (),
    quality: str = "balanced",
    device: str = "cpu",
    kept: dict[object, Any] | None = None,
) -> Backend:
    """Load the scene in a folder onto a device, and by their folders those ``others`` that actors are inserted from.

    ``kept`` holds the scenes that an earlier call has loaded, and afterwards those of this one. Raises `SceneError`.
    """
    paths = {"": scene_path, **{name: Path(name) for name in others}}
    backend = backend_for(device, paths.values())
    before, now, scenes = kept or {}, dict[object, Any](), {}
    for name, path in paths.items():
        key = backend.name, device, stamp(path)
        scenes[name] = now[key] = before.get(key) or backend.load(path, device)
    if kept is not None:
        kept.clear()
        kept.update(now)
    return backend.make(scenes.pop(""), quality_named(quality), scenes)
