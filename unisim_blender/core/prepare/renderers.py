"""Renderers of trained scenes, made from paths wherever they are needed: in this process or in a worker."""

from __future__ import annotations

import hashlib
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

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


def environment(device: str) -> dict[str, str]:
    """What else equal bytes depend on: machine, instruction set, libraries that compute. ModuleNotFoundError names the one that
    is not installed."""
    import torch

    return {
        "machine": platform.machine(),
        "device": device,
        "numpy": np.__version__,
        "torch": torch.__version__,
        "instruction_set": torch.backends.cpu.get_cpu_capability(),
    }


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
    from ..fields.checkpoint import load_scene
    from ..torch_tracer import TorchTracer

    before, now, loaded = kept or {}, {}, {}
    for name, path in {"": scene_path, **{name: Path(name) for name in other_scenes(drive)}}.items():
        key = device, stamp(path)
        loaded[name] = now[key] = before.get(key) or load_scene(path, device)
    if kept is not None:
        kept.clear()
        kept.update(now)
    return TorchTracer(loaded.pop(""), drive, quality, loaded)


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
