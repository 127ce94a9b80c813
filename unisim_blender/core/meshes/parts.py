"""Parts of a mesh file while it is read: triangles with what colours them, their textures, and a model of them all."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ScenarioError, in_a_line
from ..geometry import FloatArray
from .model import FLAT, MeshModel, check_faces, face_normals

GREY = 0.5
"""The colour of what states none, sRGB."""
SHARP = np.cos(np.radians(40))
"""Cosine of the angle between faces beyond which a computed normal is not smoothed over their edge."""


@dataclass
class MeshPart:
    """Triangles: vertices (V, 3), faces (F, 3), linear colours (F, 3, 3) of their corners. normals (F, 3, 3) are those
    of the file, None where it has none. uv (F, 3, 2) from the lower left, with texture (H, W, 3), or both None."""

    vertices: FloatArray
    faces: NDArray[Any]
    colours: NDArray[Any]
    normals: NDArray[Any] | None = None
    uv: NDArray[Any] | None = None
    texture: NDArray[np.uint8] | None = None


def joined(parts: Sequence[MeshPart], path: Path) -> MeshModel:
    """One model of parts, without the vertices that no face names. Raises `ScenarioError`."""
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
    """Normals (F, 3, 3) of faces' corners: the mean of the faces round a place, weighted by their angles there; the
    face's own where that is across a sharp edge."""
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
    """A file's normals (F, 3, 3) at unit length; the face's own where they have none."""
    with np.errstate(all="ignore"):
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        good = np.isfinite(length) & (length > 1e-9)
        return np.where(good, normals / length, _flat(vertices, faces))


def texture_of(content: bytes, name: str, path: Path) -> NDArray[np.uint8]:
    """Pixels (H, W, 3), sRGB, of an image file's content. Raises `ScenarioError`, which names texture and mesh file."""
    from PIL import Image, UnidentifiedImageError  # here: Blender's own Python need not have it

    try:
        with Image.open(io.BytesIO(content)) as image:
            return texture_pixels(image)
    except UnidentifiedImageError as fault:
        raise ScenarioError(f"{path}: its texture {name} cannot be read: is no image that Pillow knows") from fault
    except Exception as fault:  # Pillow's decoders raise whatever they like at a broken file
        raise ScenarioError(f"{path}: its texture {name} cannot be read: {in_a_line(fault)}") from fault


def texture_pixels(image: Any) -> NDArray[np.uint8]:
    """Pixels (H, W, 3), sRGB, of an image that Pillow opened; 16 bits become the nearest 8, transparency is dropped.
    Raises ValueError for modes whose range is not known."""
    if image.mode.startswith("I"):
        wide = np.asarray(image).astype(np.int64)
        if wide.size and (wide.min() < 0 or wide.max() > 65535):
            raise ValueError(f"its pixels of mode {image.mode} hold {wide.min()} to {wide.max()}, not 0 to 65535")
        return np.repeat(((wide * 255 + 32767) // 65535).astype(np.uint8)[..., None], 3, -1)
    if image.mode in ("F", "LAB"):
        raise ValueError(f"its pixels have mode {image.mode}, whose range is not known")
    return np.array(image.convert("RGB"), np.uint8)
