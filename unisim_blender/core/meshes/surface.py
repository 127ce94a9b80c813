"""What a mesh looks like where a ray hits it: its normal and colour there, and simple light on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..geometry import FloatArray
from .intersect import FirstHits
from .model import MeshModel

SKY, SUN = 0.65, 0.35
"""How much of the light on level ground comes from all over the sky, and how much from the sun."""
TO_SUN = np.array([0.42, 0.32, 0.85]) / np.linalg.norm([0.42, 0.32, 0.85])
"""A direction that no recording told: from above, a little from one side, so that a body's faces differ."""
_LINEAR = linear_from_srgb(np.arange(256, dtype=np.float32) / 255)


def normals_at(model: MeshModel, hits: FirstHits, directions: FloatArray) -> FloatArray:
    """Unit normals (N, 3) of hits, in the model's axes, on the side that rays of directions (N, 3) come from."""
    normal = _at(model.normals, hits).astype(np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-6, normal / np.where(length > 1e-6, length, 1.0), -directions)
    return np.asarray(np.where((normal * directions).sum(1, keepdims=True) > 0, -normal, normal))


def colours_at(model: MeshModel, hits: FirstHits) -> FloatArray:
    """Colours (N, 3) of the surface, linear Rec.709 in 0..1."""
    colours = _at(model.colours, hits).astype(np.float64)
    texture = model.texture[hits.face]
    for i, image in enumerate(model.textures):
        mine = texture == i
        if mine.any():
            uv = _at(model.uv, FirstHits(hits.t[mine], hits.face[mine], hits.uv[mine]))
            colours[mine] *= _bilinear(image, uv)
    return colours


def lit(colours: FloatArray, normals: FloatArray, level: FloatArray) -> FloatArray:
    """Light (N, 3), linear, that surfaces of ``colours`` (N, 3) with unit ``normals`` (N, 3), world frame, send out,
    from a sky and a sun without shadows, under which white level ground sends out ``level`` (N, 3)."""
    sky = SKY * (1 + normals[:, 2]) / 2
    sun = SUN * np.maximum(normals @ TO_SUN, 0) / TO_SUN[2]
    return np.asarray(colours * level * (sky + sun)[:, None])


def reflectivity(colours: FloatArray, cosine: FloatArray) -> FloatArray:
    """LiDAR intensity (N,) in 0..1 of matt surfaces of linear ``colours`` (N, 3), hit at angles with
    that cosine (N,)."""
    return np.asarray(np.clip(colours @ np.array([0.2126, 0.7152, 0.0722]) * np.abs(cosine), 0, 1))


def _at(values: NDArray[np.float32], hits: FirstHits) -> NDArray[np.float32]:
    """Values (F, 3, C) of faces' corners between them: (N, C)."""
    u, v = hits.uv[:, :1], hits.uv[:, 1:]
    a, b, c = (values[hits.face, k] for k in range(3))
    return np.asarray(a * (1 - u - v) + b * u + c * v)


def _bilinear(image: NDArray[np.uint8], uv: NDArray[np.float32]) -> FloatArray:
    """A texture's linear colours (N, 3) at uv (N, 2), repeated beyond its edges."""
    height, width = image.shape[:2]
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    right, down = (x - column)[:, None], (y - row)[:, None]

    def texel(r: NDArray[np.int64], c: NDArray[np.int64]) -> NDArray[np.float32]:
        return _LINEAR[image[r % height, c % width]]

    top = texel(row, column) * (1 - right) + texel(row, column + 1) * right
    bottom = texel(row + 1, column) * (1 - right) + texel(row + 1, column + 1) * right
    return np.asarray(top * (1 - down) + bottom * down, np.float64)
