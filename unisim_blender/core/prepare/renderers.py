"""Renderers of trained scenes, made from paths wherever they are needed: in this process or in a worker."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..drive import Drive
from ..files import sha256_of_file
from ..scene_file import HEADER_NAME, WEIGHTS_NAME

if TYPE_CHECKING:
    from ..render import Renderer


def pick_device(name: str) -> str:
    """A device by its name; "auto" is the best there is here."""
    if name != "auto":
        return name
    import torch

    return "cuda" if torch.cuda.is_available() else "mps" if torch.backends.mps.is_available() else "cpu"


def other_scenes(drive: Drive) -> tuple[str, ...]:
    """Folders of the trained scenes that actors were inserted from."""
    return tuple(sorted({actor.look.scene for actor in drive.actors.values()} - {""}))


def scene_hash(path: Path) -> str:
    """One digest of a trained scene's two files."""
    parts = [sha256_of_file(path / name) for name in (HEADER_NAME, WEIGHTS_NAME)]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()


def scene_hashes(scene: Path, drive: Drive) -> dict[str, str]:
    """Digests of all scenes and meshes that a drive is rendered with, by the name that looks have for them."""
    meshes = {actor.look.mesh for actor in drive.actors.values()} - {""}
    others = {name: scene_hash(Path(name)) for name in other_scenes(drive)}
    return {"": scene_hash(scene), **others, **{name: sha256_of_file(Path(name)) for name in sorted(meshes)}}


@dataclass(frozen=True)
class SceneSource:
    """Makes the neural renderer of a drive; pickles, and imports torch when it is called."""

    scene: Path
    drive: Drive
    quality: str = "balanced"
    device: str = "cpu"
    draw: int | None = None
    shadows: bool = False

    def __call__(self) -> Renderer:
        """Load the scene and those that actors were inserted from. Raises `SceneError`."""
        from ..fields.checkpoint import load_scene
        from ..render import Renderer

        others = {name: load_scene(name, self.device) for name in other_scenes(self.drive)}
        return Renderer(load_scene(self.scene, self.device), self.drive, self.quality, others, self.draw, self.shadows)
