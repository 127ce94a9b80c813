"""Renderers of trained scenes, made from paths wherever they are needed: in this process or in a worker."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .. import native
from ..compiled.scene import CompiledScene
from ..compiled.tracer import CompiledTracer
from ..drive import Drive
from ..files import sha256_of_file
from ..render import Renderer
from ..scene_file import HEADER_NAME, WEIGHTS_NAME
from ..tracer import Tracer
from ..weights import weights_hash


def pick_device(name: str) -> str:
    """A device by its name; "auto" is the best there is here: the CPU, where torch is not installed."""
    if name != "auto":
        return name
    try:
        import torch
    except ModuleNotFoundError:
        return "cpu"
    return "cuda" if torch.cuda.is_available() else "mps" if torch.backends.mps.is_available() else "cpu"


def other_scenes(drive: Drive) -> tuple[str, ...]:
    """Folders of the trained scenes that actors were inserted from."""
    return tuple(sorted({actor.look.scene for actor in drive.actors.values()} - {""}))


def scene_hash(path: Path) -> str:
    """One digest of a trained scene's two files."""
    parts = [sha256_of_file(path / HEADER_NAME), weights_hash(path)]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()


def scene_hashes(scene: Path, drive: Drive) -> dict[str, str]:
    """Digests of all scenes and meshes that a drive is rendered with, by the name that looks have for them."""
    meshes = {actor.look.mesh for actor in drive.actors.values()} - {""}
    others = {name: scene_hash(Path(name)) for name in other_scenes(drive)}
    return {"": scene_hash(scene), **others, **{name: sha256_of_file(Path(name)) for name in sorted(meshes)}}


def compiled(device: str) -> bool:
    """Whether rays are traced by the compiled kernels there: on the CPU, where they were built."""
    return device == "cpu" and native.library() is not None


def environment(device: str) -> dict[str, str]:
    """What else equal bytes depend on: machine, instruction set, libraries that compute. ModuleNotFoundError names the one that
    is not installed."""
    common = {"machine": platform.machine(), "device": device, "numpy": np.__version__}
    if compiled(device):
        return {**common, "kernels": str(native.ABI_VERSION), "instruction_set": native.variant()}
    import torch

    return {**common, "torch": torch.__version__, "instruction_set": torch.backends.cpu.get_cpu_capability()}


def stamp(scene: Path) -> object:
    """What changes when a trained scene is written anew. A digest would take longer than a picture of the view."""
    files = [scene / name for name in (HEADER_NAME, WEIGHTS_NAME)]
    return scene, *((file.stat().st_mtime_ns, file.stat().st_size) if file.is_file() else None for file in files)


def make_tracer(
    scene_path: Path, drive: Drive, quality: str = "balanced", device: str = "cpu", kept: dict[object, Any] | None = None
) -> Tracer:
    """What traces a drive's rays on a device, of the scene in a folder and of those that actors were inserted from.

    ``kept`` holds the scenes that an earlier call has loaded, and afterwards those of this one. Raises `SceneError`.
    """
    if compiled(device):
        scene, others = _loaded(CompiledScene, scene_path, drive, device, kept)
        return CompiledTracer(scene, drive, quality, others)
    from ..fields.checkpoint import load_scene
    from ..torch_tracer import TorchTracer

    scene, others = _loaded(partial(load_scene, device=device), scene_path, drive, device, kept)
    return TorchTracer(scene, drive, quality, others)


def _loaded(
    load: Callable[[Path], Any], scene_path: Path, drive: Drive, device: str, kept: dict[object, Any] | None
) -> tuple[Any, dict[str, Any]]:
    """The scene in a folder, and by their paths those that actors were inserted from."""
    before, now, loaded = kept or {}, {}, {}
    for name, path in {"": scene_path, **{name: Path(name) for name in other_scenes(drive)}}.items():
        key = device, stamp(path)
        loaded[name] = now[key] = before.get(key) or load(path)
    if kept is not None:
        kept.clear()
        kept.update(now)
    return loaded.pop(""), loaded


@dataclass(frozen=True)
class SceneSource:
    """Makes the neural renderer of a drive; pickles, and imports what computes when it is called."""

    scene: Path
    drive: Drive
    quality: str = "balanced"
    device: str = "cpu"
    draw: int | None = None
    shadows: bool = False

    def __call__(self) -> Renderer:
        """Load the scene and those that actors were inserted from. Raises `SceneError`."""
        return Renderer(make_tracer(self.scene, self.drive, self.quality, self.device), self.drive, self.draw, self.shadows)
