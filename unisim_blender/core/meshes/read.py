"""Mesh files: our own, and what trimesh reads (glTF, OBJ, PLY, STL and more)."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..errors import ScenarioError, in_a_line
from ..geometry import FloatArray
from .model import FLAT, SUFFIX, MeshModel, centred, check_faces, check_model, face_normals, read_model

GLTF = (".glb", ".gltf")
"""Formats whose z points forward, x left and y up, and whose colours are linear."""
PLAIN = (".ply", ".off")
"""Formats in which a face may name a vertex below 0, which trimesh takes for one counted from the end."""
GREY = 0.5
"""What has no colour, sRGB."""


def read_mesh(path: Path) -> MeshModel:
    """The mesh in a file, about the middle of its extent. Raises `ScenarioError`."""
    try:
        changed = path.stat().st_mtime_ns
    except OSError as fault:
        raise ScenarioError(f"{path}: cannot be read: {fault.strerror}") from fault
    return _read(path, changed)


@functools.lru_cache(maxsize=16)
def _read(path: Path, changed: int) -> MeshModel:
    model = read_model(path) if path.suffix.lower() == SUFFIX else _from_trimesh(path)
    return centred(model)[0]


def mesh_size_m(path: Path) -> FloatArray:
    """The extent (3,) of the mesh in a file, which is its actor's box. Raises `ScenarioError`."""
    return read_mesh(path).size_m


def _from_trimesh(path: Path) -> MeshModel:
    try:
        import trimesh  # here: Blender's own Python need not have it
    except ImportError as fault:
        raise ScenarioError(
            f"{path}: trimesh, which reads it, is not installed; only {SUFFIX} needs nothing"
        ) from fault
    try:
        if path.suffix.lower() in PLAIN:
            for part in trimesh.load_scene(path, process=False).dump():
                if isinstance(part, trimesh.Trimesh):
                    check_faces(np.asarray(part.vertices), np.asarray(part.faces), path)
        parts = trimesh.load_scene(path).dump()
        meshes = [part for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    except ScenarioError:
        raise
    except Exception as fault:  # readers raise whatever they like at a broken file
        raise ScenarioError(f"{path}: cannot be read as a mesh: {in_a_line(fault)}") from fault
    if not meshes:
        raise ScenarioError(f"{path}: holds no triangle")
    for mesh in meshes:
        check_faces(np.asarray(mesh.vertices), np.asarray(mesh.faces), path)
    linear = path.suffix.lower() in GLTF
    textures: list[NDArray[np.uint8]] = []
    try:
        pieces = [_piece(mesh, linear, textures) for mesh in meshes]
    except Exception as fault:  # trimesh works colours and textures out when they are asked for
        raise ScenarioError(f"{path}: its colours or textures cannot be read: {in_a_line(fault)}") from fault
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    axes = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]) if linear else np.eye(3)
    vertices = np.concatenate([mesh.vertices for mesh in meshes]) @ axes.T
    faces = np.concatenate([mesh.faces + first[i] for i, mesh in enumerate(meshes)]).astype(np.int32)
    normals, colours, uv, texture = (np.concatenate([piece[k] for piece in pieces]) for k in range(4))
    model = MeshModel(
        vertices.astype(np.float32), faces, (normals @ axes.T).astype(np.float32), colours.astype(np.float32),
        uv.astype(np.float32), texture.astype(np.int32), tuple(textures),
    )  # fmt: skip
    check_model(model, path)
    return model


def _piece(mesh: Any, linear: bool, textures: list[NDArray[np.uint8]]) -> tuple[NDArray[Any], ...]:
    """Normals, colours, uv and texture of one part's triangles; its image is added to ``textures``."""
    faces = mesh.faces
    normals = np.asarray(mesh.vertex_normals)[faces]
    flat = face_normals(np.asarray(mesh.vertices, np.float32), faces.astype(np.int32))[:, None]
    # a vertex that faces share across a sharp edge has a normal of neither
    normals = np.where((normals * flat).sum(-1, keepdims=True) > np.cos(np.radians(40)), normals, flat)
    uv, texture = np.zeros((len(faces), 3, 2)), np.full(len(faces), FLAT)
    colours = np.full((len(faces), 3, 3), GREY)
    visual = mesh.visual
    if visual.kind == "texture":
        material = visual.material
        factor = getattr(material, "baseColorFactor", None)
        factor = getattr(material, "diffuse", None) if factor is None else factor
        if factor is not None:
            colours[:] = np.asarray(factor, float)[:3] / (255 if np.asarray(factor).dtype == np.uint8 else 1)
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        if image is not None and visual.uv is not None:
            if factor is None:
                colours[:] = 1.0
            uv, texture[:] = np.asarray(visual.uv)[faces], len(textures)
            textures.append(np.asarray(image.convert("RGB"), np.uint8))
    elif visual.kind == "vertex":
        colours = visual.vertex_colors[faces][..., :3] / 255
    elif visual.kind == "face":
        colours = np.repeat(visual.face_colors[:, None, :3], 3, 1) / 255
    return normals, colours if linear and visual.kind else linear_from_srgb(colours), uv, texture
