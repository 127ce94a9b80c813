"""A mesh as it is rendered: triangles with normals, colours and textures, and its own file.

Axes as an actor's box has them: x forward, y left, z up, metres, the origin in the middle of the mesh's extent.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ScenarioError, in_a_line
from ..files import partial_file, read_arrays
from ..geometry import FloatArray

SUFFIX = ".npz"
MOST = 1e6
"""No coordinate, colour or normal is larger."""
FLAT = -1
"""The texture of a triangle that has none."""


@dataclass(frozen=True, eq=False)
class MeshModel:
    """vertices (V, 3) float32, faces (F, 3) int32; for each face's corners normals (F, 3, 3), colours (F, 3, 3) linear
    Rec.709 in 0..1, and uv (F, 3, 2), from the lower left of texture ``texture`` (F,), `FLAT` for none. textures:
    (H, W, 3) uint8 sRGB, top row first; they multiply the colours."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    colours: NDArray[np.float32]
    uv: NDArray[np.float32]
    texture: NDArray[np.int32]
    textures: tuple[NDArray[np.uint8], ...] = ()

    @property
    def size_m(self) -> FloatArray:
        """The extent (3,)."""
        return np.asarray(np.ptp(self.vertices.astype(np.float64), axis=0))


def centred(model: MeshModel) -> tuple[MeshModel, FloatArray]:
    """The model about the middle of its extent, and where that middle was (3,)."""
    middle = (model.vertices.min(0).astype(np.float64) + model.vertices.max(0)) / 2
    moved = (model.vertices - middle).astype(np.float32)
    return MeshModel(moved, model.faces, model.normals, model.colours, model.uv, model.texture, model.textures), middle


def face_normals(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Unit normals (F, 3) of triangles; those without area point up. Raises `ScenarioError` for faces that are none."""
    check_faces(vertices, faces)
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(length > 0, normal / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0]).astype(np.float32)


def write_model(model: MeshModel, path: Path) -> None:
    """Write the model's own file. Raises `OutputError`."""
    arrays = {name: getattr(model, name) for name in ("vertices", "faces", "normals", "colours", "uv", "texture")}
    arrays |= {f"texture_{i}": image for i, image in enumerate(model.textures)}
    with partial_file(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


def read_model(path: Path) -> MeshModel:
    """The model in its own file. Raises `ScenarioError`."""
    arrays = read_arrays(path, ScenarioError, "is no mesh file")
    textures = tuple(arrays[name] for name in sorted(arrays, key=lambda n: (len(n), n)) if name.startswith("texture_"))
    kinds = {"vertices": np.float32, "faces": np.int32, "normals": np.float32, "colours": np.float32, "uv": np.float32}
    try:
        known: dict[str, Any] = {
            name: arrays[name].astype(kind, casting="same_kind")
            for name, kind in (*kinds.items(), ("texture", np.int32))
        }
        model = MeshModel(**known, textures=textures)
    except (KeyError, TypeError) as fault:
        raise ScenarioError(f"{path}: is no mesh file: {in_a_line(fault)}") from fault
    check_model(model, path)
    return model


def check_faces(vertices: NDArray[Any], faces: NDArray[Any], place: Path | str = "a mesh") -> None:
    """Raise `ScenarioError`, which names ``place``, unless faces (F, 3) are triangles of vertices (V, 3)
    that are there."""
    for name, array in (("vertices", vertices), ("faces", faces)):
        if array.ndim != 2 or array.shape[1] != 3:
            wanted = "(V, 3)" if name == "vertices" else "(F, 3): every face must be a triangle"
            raise ScenarioError(f"{place}: {name} has shape {array.shape}, not {wanted}")
    if len(faces) and not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
        face = int(((faces < 0) | (faces >= len(vertices))).any(1).argmax())
        raise ScenarioError(
            f"{place}: face {face} is {faces[face].tolist()} and names a vertex that is not there: there are {len(vertices)}"
        )


def check_model(model: MeshModel, path: Path) -> None:
    """Raise `ScenarioError` where a model's arrays do not fit together or hold what cannot be rendered."""

    def require(holds: bool, problem: str) -> None:
        if not holds:
            raise ScenarioError(f"{path}: {problem}")

    check_faces(model.vertices, model.faces, path)
    faces = len(model.faces)
    require(faces > 0, "holds no triangle")
    shapes = {"normals": (faces, 3, 3), "colours": (faces, 3, 3), "uv": (faces, 3, 2), "texture": (faces,)}
    for name, shape in shapes.items():
        require(getattr(model, name).shape == shape, f"{name} has shape {getattr(model, name).shape}, not {shape}")
    for name in ("vertices", "normals", "colours", "uv"):
        values = getattr(model, name)
        require(bool(np.isfinite(values).all()), f"{name} hold values that are not finite")
        require(float(np.abs(values).max()) <= MOST, f"{name} hold values beyond {MOST:g}")
    require(
        model.texture.min() >= FLAT and model.texture.max() < len(model.textures),
        "a texture is named that is not there",
    )
    for i, image in enumerate(model.textures):
        fits = image.ndim == 3 and image.shape[2] == 3 and image.size > 0 and image.dtype == np.uint8
        require(fits, f"texture {i} has shape {image.shape} and type {image.dtype}, not (H, W, 3) uint8")
    require(float(model.size_m.max()) > 0, "has no extent")
