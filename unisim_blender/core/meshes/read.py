"""Mesh files: our own, glTF, OBJ, PLY and OFF, and the other formats that trimesh reads (STL, 3MF and more)."""

from __future__ import annotations

import functools
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..colour import linear_from_srgb
from ..errors import ScenarioError, in_a_line, refused
from ..files import file_stamp
from ..geometry import FloatArray
from .gltf import read_gltf
from .model import (
    GREY,
    SUFFIX,
    MeshModel,
    MeshPart,
    centred,
    check_faces,
    check_model,
    joined,
    read_model,
    texture_pixels,
)
from .obj import read_obj
from .ply import read_ply
from .polygons import read_off

READERS = {".gltf": read_gltf, ".glb": read_gltf, ".obj": read_obj, ".ply": read_ply, ".off": read_off}
LARGEST_M, SMALLEST_M = 100.0, 0.05
"""Largest and smallest extent, metres, at which a file's unit is not doubted."""


def read_mesh(path: Path) -> MeshModel:
    """Return the mesh in a file, the middle of its extent at the origin. Warns once of `mesh_notes`. Raises
    `ScenarioError`."""
    return _read(path, _changed(path))[0]


def mesh_size_m(path: Path) -> FloatArray:
    """Return the extent (3,), metres, of the mesh in a file, which is its actor's box. Raises `ScenarioError`."""
    return read_mesh(path).size_m


def mesh_notes(path: Path) -> tuple[str, ...]:
    """Return a sentence, which names the file, on each thing in it that is left out or doubted. Raises
    `ScenarioError`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _read(path, _changed(path))[1]


def _changed(path: Path) -> tuple[int, ...]:
    with refused(path, "read", ScenarioError):
        return file_stamp(path)


@functools.lru_cache(maxsize=16)
def _read(path: Path, changed: tuple[int, ...]) -> tuple[MeshModel, tuple[str, ...]]:
    notes: list[str] = []
    suffix = path.suffix.lower()
    if suffix == SUFFIX:
        model = read_model(path)
    else:
        try:
            parts = READERS.get(suffix, _from_trimesh)(path, notes)
            model = joined(parts, path)
        except ScenarioError:
            raise
        except Exception as fault:  # a broken file may hold anything anywhere
            what = f"{type(fault).__name__}: {in_a_line(fault)}" if isinstance(fault, LookupError) else in_a_line(fault)
            raise ScenarioError(f"{path}: cannot be read as a mesh: {what}") from fault
        check_model(model, path)
    longest = float(model.size_m.max())
    if not SMALLEST_M <= longest <= LARGEST_M:
        notes.append(f"its extent is {longest:.3g} m: is its unit the metre?")
    sentences = tuple(f"{path}: {note}" for note in notes)
    for sentence in sentences:
        warnings.warn(sentence, stacklevel=4)
    return centred(model)[0], sentences


def _from_trimesh(path: Path, notes: list[str]) -> list[MeshPart]:
    try:
        import trimesh  # here: Blender's own Python need not have it
    except ImportError as fault:
        raise ScenarioError(f"{path}: trimesh, which reads {path.suffix} files, is not installed") from fault
    parts = []
    for mesh in trimesh.load_scene(path).dump():
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            check_faces(np.asarray(mesh.vertices), np.asarray(mesh.faces), path)
            parts.append(_part(mesh))
    return parts


def _part(mesh: Any) -> MeshPart:
    """Return one of trimesh's meshes. Materials that trimesh adds to a file without any are left out."""
    faces, visual = np.asarray(mesh.faces), mesh.visual
    colours: Any = np.full((len(faces), 3, 3), GREY)
    uv = texture = None
    if visual.kind == "texture":
        material = visual.material
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        if image is not None and visual.uv is not None and not _is_stand_in(image):
            texture, uv = texture_pixels(image), np.asarray(visual.uv)[faces]
            colours = np.ones((len(faces), 3, 3))
        factor = getattr(material, "baseColorFactor", None)
        if factor is not None:
            wide = np.asarray(factor)
            colours = np.broadcast_to(wide[:3] / (255 if wide.dtype == np.uint8 else 1), (len(faces), 3, 3))
    elif visual.kind == "vertex":
        colours = visual.vertex_colors[faces][..., :3] / 255
    elif visual.kind == "face":
        colours = np.repeat(visual.face_colors[:, None, :3], 3, 1) / 255
    return MeshPart(mesh.vertices, faces, linear_from_srgb(colours), None, uv, texture)


def _is_stand_in(image: Any) -> bool:
    """Return whether an image is the one that trimesh gives to texture coordinates without a material."""
    from trimesh.visual.material import empty_material

    own = empty_material().image
    return bool(
        image.size == own.size and np.array_equal(np.asarray(image.convert("RGBA")), np.asarray(own.convert("RGBA")))
    )
