"""Trained scenes: each is opened once and passed on. Also the scenes and meshes that a drive's actors come from, and what a
scene cannot give that a drive asks for."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..files import file_stamp, sha256_of_file
from ..meshes.read import read_mesh
from ..model.config import ModelConfig
from ..model.scene_file import HEADER_NAME, WEIGHTS_NAME, SceneHeader, read_header, weights_hash
from ..world.drive import Actor, Drive

MULTI_FILE_FORMATS = (".obj", ".gltf", ".ply")
"""Formats of meshes whose materials, textures or buffers lie in files beside them."""


_MAX_NAMED_ACTORS = 5
"""Largest number of actors that are named."""


class Scene:
    """A trained scene in the folder ``path``. Its header is read once; in another process, into which it is pickled by its path,
    where it is first asked for. `SceneError` then says what is wrong with it."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)

    def __reduce__(self) -> tuple[type[Scene], tuple[Path]]:
        return Scene, (self.path,)

    @cached_property
    def _opened(self) -> tuple[SceneHeader, str, tuple[object, ...]]:
        stamps = self._stamps()
        return *read_header(self.path), stamps

    @property
    def header(self) -> SceneHeader:
        """Header of the scene: its model, its refined drive, and what it was trained on."""
        return self._opened[0]

    @cached_property
    def digest(self) -> str:
        """One SHA-256 of the scene's two files."""
        parts = [self._opened[1], weights_hash(self.path)]
        return hashlib.sha256(" ".join(parts).encode()).hexdigest()

    @cached_property
    def config(self) -> ModelConfig:
        return ModelConfig.from_dict(self.header.model)

    @property
    def has_actors(self) -> bool:
        """Whether its actors can be moved; else it is one field."""
        return self.config.actors != "none"

    @property
    def has_lidar(self) -> bool:
        """Whether it was trained with LiDAR."""
        return "lidar" not in self.header.training.get("without", ())

    def is_current(self) -> bool:
        """Return whether its files are those that were opened, by their stamps: digests would take longer than an image."""
        return self._opened[2] == self._stamps()

    def _stamps(self) -> tuple[object, ...]:
        files = [self.path / name for name in (HEADER_NAME, WEIGHTS_NAME)]
        return tuple(file_stamp(file) if file.is_file() else None for file in files)


def open_scene(path: Path) -> Scene:
    """Read the header of the trained scene in folder ``path``. Raises `SceneError`."""
    scene = Scene(path)
    _ = scene.header
    return scene


class OpenScenes:
    """Trained scenes by their folders, each opened once, and again when its files are others."""

    def __init__(self) -> None:
        self._scenes: dict[Path, Scene] = {}

    def open(self, path: Path | str) -> Scene:
        """Return the scene in a folder. Raises `SceneError`."""
        path = Path(path)
        scene = self._scenes.get(path)
        if scene is None or not scene.is_current():
            scene = self._scenes[path] = open_scene(path)
        return scene

    def others(self, drive: Drive) -> dict[str, Scene]:
        """Return the scenes that a drive's actors were inserted from, by their names in `Appearance`. Raises `SceneError`."""
        return {name: self.open(name) for name in other_scenes(drive)}

    def actors(self, path: Path) -> dict[str, Actor]:
        """Return the actors of the scene in a folder, as edits ask for them. Raises `SceneError`."""
        return self.open(path).header.drive.actors


def other_scenes(drive: Drive) -> tuple[str, ...]:
    """Return the folders of the trained scenes that actors were inserted from."""
    return tuple(sorted({actor.appearance.scene for actor in drive.actors.values()} - {""}))


def without_other_scenes(drive: Drive) -> tuple[Drive, list[str]]:
    """Return a drive without the actors of other trained scenes, which surfels cannot show, and a sentence that names them."""
    foreign = [uid for uid, actor in drive.actors.items() if actor.appearance.scene]
    if not foreign:
        return drive, []
    own = {uid: actor for uid, actor in drive.actors.items() if uid not in foreign}
    return replace(drive, actors=own), [
        f"{_named(foreign)}: not shown, since actors of another scene need a trained scene of this drive"
    ]


def mesh_digests(drive: Drive) -> dict[str, str]:
    """Return digests of all meshes in a drive, by their names in `Appearance`."""
    meshes = {actor.appearance.mesh for actor in drive.actors.values()} - {""}
    return {name: _mesh_digest(Path(name)) for name in sorted(meshes)}


def _mesh_digest(path: Path) -> str:
    """Return the digest of a mesh's file, and of what it is made of where that may lie in other files: materials and textures."""
    own = sha256_of_file(path)
    if path.suffix.lower() not in MULTI_FILE_FORMATS:
        return own
    model = read_mesh(path)
    if path.suffix.lower() == ".ply" and not model.textures:
        return own
    whole = hashlib.sha256(own.encode())
    for array in (model.vertices, model.faces, model.colours, model.uv, model.texture, *model.textures):
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()


def capability_warnings(scene: Scene, recorded: Drive, edited: Drive, sweeps: bool) -> list[str]:
    """Return one sentence for each thing that comes out otherwise than asked; ``sweeps`` says whether any are wanted."""
    name, warnings = scene.header.name, []
    changed = [uid for uid in recorded.actors if edited.actors.get(uid) is not recorded.actors[uid]]
    added = [
        uid
        for uid, a in edited.actors.items()
        if uid not in recorded.actors and not a.appearance.scene and not a.appearance.mesh
    ]
    if not scene.has_actors and (changed or added):
        warnings.append(
            f"scene {name!r} is one field without actors: edits of {_named([*changed, *added])} change labels, but no "
            "image or sweep"
        )
    if sweeps and not scene.has_lidar:
        warnings.append(
            f"scene {name!r} was trained without LiDAR: the intensities and drops of its sweeps mean nothing"
        )
    return warnings


def _named(uids: list[str]) -> str:
    more = len(uids) - _MAX_NAMED_ACTORS
    return ", ".join(uids[:_MAX_NAMED_ACTORS]) + (f" and {more} more" if more > 0 else "")
