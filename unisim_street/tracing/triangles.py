"""A surface of triangles as a shape: what a street drawn by a path tracer is made of, so that LiDAR hits
the same surface."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import BoolArray, FloatArray
from unisim_blender.core.meshes.intersect import Mesh
from unisim_blender.core.meshes.model import FLAT, MeshModel, face_normals

from .shapes import TracedShape

_BACK_M = 1e-3
"""How far before a surface point the ray starts that finds its triangle again."""


class TracedTriangles(TracedShape):
    """Triangles with corners (F, 3, 3), counter-clockwise from outside, seen from both sides.

    normals (F, 3, 3): unit normals to shade with at the corners; None: each face's own. ``speckled``: the faces are
    small and each has one colour, as leaves have.
    """

    def __init__(self, corners: NDArray[Any], normals: NDArray[Any] | None = None, speckled: bool = False) -> None:
        # float32 as the path tracer keeps them: both hit the same surface
        self.corners: NDArray[np.float32] = np.ascontiguousarray(corners, np.float32)
        flat = face_normals(self.corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3))
        self.face_normals: NDArray[np.float32] = flat
        self.soft: NDArray[np.float32] = (
            np.repeat(flat[:, None], 3, 1) if normals is None else np.asarray(normals, np.float32)
        )
        self.speckled = speckled
        self.low, self.high = (
            (self.corners.reshape(-1, 3).astype(np.float64)).min(0),
            self.corners.reshape(-1, 3).max(0) * 1.0,
        )

    @cached_property
    def flat(self) -> BoolArray:
        """Which faces (F,) are shaded with their own normal."""
        return np.asarray((np.abs(self.soft - self.face_normals[:, None]) < 1e-4).all((1, 2)))

    @cached_property
    def _mesh(self) -> Mesh:
        count = len(self.corners)
        faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
        nothing = np.zeros((count, 3, 2), np.float32)
        model = MeshModel(
            self.corners.reshape(-1, 3), faces, self.soft, self.soft, nothing, np.full(count, FLAT, np.int32)
        )
        return Mesh(model)

    def intersect(self, origins: FloatArray, directions: FloatArray, t_min: FloatArray) -> FloatArray:
        return np.asarray(t_min + self._mesh.first_hits(origins + t_min[:, None] * directions, directions, 0.0).t)

    def faced(self, points: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The normals of the side that the rays come from."""
        hits = self._mesh.first_hits(points - _BACK_M * directions, directions, 0.0)
        u, v = hits.uv[:, :1].astype(np.float64), hits.uv[:, 1:].astype(np.float64)
        found = hits.face >= 0
        face = np.where(found, hits.face, 0)
        soft = self.soft[face].astype(np.float64)
        soft = soft[:, 0] * (1 - u - v) + soft[:, 1] * u + soft[:, 2] * v
        soft /= np.maximum(np.linalg.norm(soft, axis=1, keepdims=True), 1e-9)
        own = self.face_normals[face].astype(np.float64)
        # a ray along an edge may miss it on its second way: it is taken as hit head-on
        own, soft = (np.where(found[:, None], n, -directions) for n in (own, soft))
        behind = (own * directions).sum(1, keepdims=True) > 0
        return np.where(behind, -own, own), np.where(behind, -soft, soft)


def joined(parts: list[TracedTriangles]) -> TracedTriangles:
    """All of them as one."""
    return TracedTriangles(np.concatenate([p.corners for p in parts]), np.concatenate([p.soft for p in parts]))


def quads(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """Two triangles for each quadrilateral with corners a, b, c, d (Q, 3), counter-clockwise: (2 Q, 3, 3)."""
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def grid(points: FloatArray) -> TracedTriangles:
    """A smooth surface through points (R, C, 3), its outside where rows cross columns.

    Points that coincide are one, and the triangles between them are left out.
    """
    rows, columns = points.shape[:2]
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (n.reshape(-1) for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return smooth(points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def smooth(vertices: FloatArray, faces: NDArray[np.int64], crease_deg: float = 50.0) -> TracedTriangles:
    """Triangles (F, 3) of vertices (V, 3) with rounded normals; faces that meet at more than ``crease_deg``
    keep their edge."""
    _, merged = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    keep = size > 1e-10
    faces, corners, cross, size = faces[keep], corners[keep], cross[keep], size[keep]
    unit = cross / size[:, None]
    corner_of = merged.reshape(-1)[faces].reshape(-1)
    order = np.argsort(corner_of, kind="stable")
    starts = np.flatnonzero(np.diff(corner_of[order], prepend=-1))
    soft = np.zeros((len(faces) * 3, 3))
    for some in np.split(order, starts[1:]):
        mine = some // 3
        close = unit[mine] @ unit[mine].T > np.cos(np.radians(crease_deg))
        soft[some] = close @ cross[mine]
    soft /= np.linalg.norm(soft, axis=1, keepdims=True)
    return TracedTriangles(corners, soft.reshape(-1, 3, 3))
