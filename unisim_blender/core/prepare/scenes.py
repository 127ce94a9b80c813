"""The trained scenes and meshes that a drive is rendered with: where they lie, and digests of them."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from ..files import file_stamp, sha256_of_file
from ..kept_results import read_once
from ..meshes.read import read_mesh
from ..model.files.scene_file import HEADER_NAME, WEIGHTS_NAME
from ..model.files.weights import weights_hash
from ..world.drive import Drive

NAMES_OTHERS = (".obj", ".gltf", ".ply")
"""Formats of meshes whose materials, textures or buffers lie in files beside them."""


def other_scenes(drive: Drive) -> tuple[str, ...]:
    """Folders of the trained scenes that actors were inserted from."""
    return tuple(sorted({actor.appearance.scene for actor in drive.actors.values()} - {""}))


def scene_paths(scene: Path, drive: Drive) -> tuple[Path, ...]:
    """Folders of all trained scenes that a drive is rendered with, its own first."""
    return scene, *map(Path, other_scenes(drive))


@read_once
def scene_hash(path: Path) -> str:
    """One digest of a trained scene's two files."""
    parts = [sha256_of_file(path / HEADER_NAME), weights_hash(path)]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()


def scene_hashes(scene: Path, drive: Drive) -> dict[str, str]:
    """Digests of all scenes and meshes that a drive is rendered with, by their names in `Appearance`; "" is the
    drive's own scene."""
    others = {name: scene_hash(Path(name)) for name in other_scenes(drive)}
    return {"": scene_hash(scene), **others, **mesh_hashes(drive)}


def mesh_hashes(drive: Drive) -> dict[str, str]:
    """Digests of all meshes in a drive, by their names in `Appearance`."""
    meshes = {actor.appearance.mesh for actor in drive.actors.values()} - {""}
    return {name: _mesh_hash(Path(name)) for name in sorted(meshes)}


def _mesh_hash(path: Path) -> str:
    """Digest of a mesh's file, and of what it is made of where that may lie in other files: materials and textures."""
    own = sha256_of_file(path)
    if path.suffix.lower() not in NAMES_OTHERS:
        return own
    model = read_mesh(path)
    if path.suffix.lower() == ".ply" and not model.textures:
        return own
    whole = hashlib.sha256(own.encode())
    for array in (model.vertices, model.faces, model.colours, model.uv, model.texture, *model.textures):
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()


def stamp(scene: Path) -> tuple[Any, ...]:
    """What changes when a trained scene is written anew. A digest would take longer than an image of the view."""
    files = [scene / name for name in (HEADER_NAME, WEIGHTS_NAME)]
    return scene, *(file_stamp(file) if file.is_file() else None for file in files)
