"""A mesh as it is rendered: triangles with normals, colours and textures, and its own file.

Axes as an actor's box has them: x forward, y left, z up, metres, the origin in the middle of the mesh's extent.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ScenarioError, in_a_line
from ..files import partial_file, read_arrays
from ..geometry import FloatArray

GREY = 0.5
"""Colour of a mesh whose file states none, sRGB in 0..1."""
SHARP = np.cos(np.radians(40))
"""Cosine of the angle between faces beyond which a computed normal is not smoothed over their edge."""


@dataclass
class MeshPart:
    """Triangles: vertices (V, 3), metres, faces (F, 3), linear colours (F, 3, 3) of their corners in 0..1. normals (F,
    3, 3) are those of the file, None where it has none. uv (F, 3, 2) from the lower left, with texture (H, W, 3) uint8
    sRGB, or both None."""

    vertices: FloatArray
    faces: NDArray[Any]
    colours: NDArray[Any]
    normals: NDArray[Any] | None = None
    uv: NDArray[Any] | None = None
    texture: NDArray[np.uint8] | None = None


def joined(parts: Sequence[MeshPart], path: Path) -> MeshModel:
    """Return one model of parts, without the vertices that no face names. Raises `ScenarioError`."""
    textures: dict[int, tuple[int, NDArray[np.uint8]]] = {}
    columns: list[tuple[NDArray[Any], ...]] = []
    first = 0
    for part in parts:
        vertices = np.asarray(part.vertices, np.float64)
        check_faces(vertices, part.faces, path)
        used, faces = np.unique(part.faces, return_inverse=True)
        vertices, faces = vertices[used], faces.reshape(-1, 3)
        if not len(faces):
            continue
        index = FLAT
        if part.texture is not None and part.uv is not None:
            index = textures.setdefault(id(part.texture), (len(textures), part.texture))[0]
        uv = part.uv if part.uv is not None and index != FLAT else np.zeros((len(faces), 3, 2))
        normals = smoothed(vertices, faces) if part.normals is None else _whole(part.normals, vertices, faces)
        colours = np.clip(part.colours, 0.0, 1.0)  # keeps what is not finite, which a model's check refuses
        columns.append((vertices, faces + first, normals, colours, uv, np.full(len(faces), index)))
        first += len(vertices)
    if not columns:
        raise ScenarioError(f"{path}: holds no triangle")
    vertices, faces, normals, colours, uv, texture = (
        np.concatenate([column[k] for column in columns]) for k in range(6)
    )
    return MeshModel(
        vertices.astype(np.float32), faces.astype(np.int32), normals.astype(np.float32), colours.astype(np.float32),
        uv.astype(np.float32), texture.astype(np.int32), tuple(image for _, image in textures.values()),
    )  # fmt: skip


def smoothed(vertices: FloatArray, faces: NDArray[Any]) -> NDArray[Any]:
    """Return normals (F, 3, 3) of faces' corners: the mean over the faces around a vertex, weighted by their angles
    there; the face's own normal across a sharp edge."""
    flat = _flat(vertices, faces)
    corners = vertices[faces]
    sides = np.roll(corners, -1, 1) - corners
    length = np.linalg.norm(sides, axis=-1, keepdims=True)
    sides = np.divide(sides, length, out=np.zeros_like(sides), where=length > 0)
    angles = np.arccos(np.clip(-(sides * np.roll(sides, 1, 1)).sum(-1), -1, 1))
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    at = place.reshape(-1)[faces]
    sums = np.zeros((len(vertices), 3))
    for corner in range(3):
        for axis in range(3):
            sums[:, axis] += np.bincount(at[:, corner], angles[:, corner] * flat[:, 0, axis], len(vertices))
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    normals = np.divide(sums, length, out=np.zeros_like(sums), where=length > 0)[at]
    return np.where((normals * flat).sum(-1, keepdims=True) > SHARP, normals, flat)


def _flat(vertices: FloatArray, faces: NDArray[Any]) -> NDArray[Any]:
    """Normals (F, 1, 3) of faces."""
    return face_normals(vertices.astype(np.float32), faces.astype(np.int32))[:, None].astype(np.float64)


def _whole(normals: NDArray[Any], vertices: FloatArray, faces: NDArray[Any]) -> NDArray[Any]:
    """Return a file's normals (F, 3, 3) at unit length; the face's own where they have none."""
    with np.errstate(all="ignore"):
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        good = np.isfinite(length) & (length > 1e-9)
        return np.where(good, normals / length, _flat(vertices, faces))


def texture_of(content: bytes, name: str, path: Path) -> NDArray[np.uint8]:
    """Return the pixels (H, W, 3) uint8, sRGB, of an image file's content. Raises `ScenarioError`, which names texture
    and mesh file."""
    from PIL import Image, UnidentifiedImageError  # here: Blender's own Python need not have it

    try:
        with Image.open(io.BytesIO(content)) as image:
            return texture_pixels(image)
    except UnidentifiedImageError as fault:
        raise ScenarioError(f"{path}: its texture {name} cannot be read: is no image that Pillow knows") from fault
    except Exception as fault:  # Pillow's decoders raise whatever they like at a broken file
        raise ScenarioError(f"{path}: its texture {name} cannot be read: {in_a_line(fault)}") from fault


def texture_pixels(image: Any) -> NDArray[np.uint8]:
    """Return the pixels (H, W, 3) uint8, sRGB, of an image that Pillow opened; 16 bits become the nearest 8,
    transparency is dropped. Raises ValueError for modes whose range is not known."""
    if image.mode.startswith("I"):
        wide = np.asarray(image).astype(np.int64)
        if wide.size and (wide.min() < 0 or wide.max() > 65535):
            raise ValueError(f"its pixels of mode {image.mode} hold {wide.min()} to {wide.max()}, not 0 to 65535")
        return np.repeat(((wide * 255 + 32767) // 65535).astype(np.uint8)[..., None], 3, -1)
    if image.mode in ("F", "LAB"):
        raise ValueError(f"its pixels have mode {image.mode}, whose range is not known")
    return np.array(image.convert("RGB"), np.uint8)


SUFFIX = ".npz"
MOST = 1e6
"""Largest absolute coordinate, colour or normal."""
FLAT = -1
"""Texture number of a triangle without a texture."""


@dataclass(frozen=True, eq=False)
class MeshModel:
    """A mesh's triangles: vertices (V, 3) float32, metres, faces (F, 3) int32; for each face's corners unit normals (F,
    3, 3), colours (F, 3, 3) linear Rec.709 in 0..1, and uv (F, 3, 2), from the lower left of texture ``texture`` (F,),
    `FLAT` for none. textures: (H, W, 3) uint8 sRGB, top row first; they multiply the colours."""

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
    """Return the model with the middle of its extent at the origin, and where that middle was (3,)."""
    middle = (model.vertices.min(0).astype(np.float64) + model.vertices.max(0)) / 2
    moved = (model.vertices - middle).astype(np.float32)
    return MeshModel(moved, model.faces, model.normals, model.colours, model.uv, model.texture, model.textures), middle


def face_normals(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return unit normals (F, 3) of triangles; those without area point up. Raises `ScenarioError` for invalid
    faces."""
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
    """Return the model in its own file. Raises `ScenarioError`."""
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
    """Raise `ScenarioError`, which names ``place``, unless faces (F, 3) are indices of vertices (V, 3)."""
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
