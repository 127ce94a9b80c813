"""The first triangle on each ray: by the compiled hierarchy of boxes, or by numpy, triangle by triangle, without it."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..geometry import FloatArray
from ..world.drive import Actor
from .model import MeshModel, check_faces


def first_hits_on(
    actor: Actor, triangles: Triangles, poses: FloatArray, origins: FloatArray, directions: FloatArray, near_m: float
) -> tuple[FirstHits, FloatArray]:
    """Return the first hits beyond ``near_m`` of rays (N, 3) with unit directions on triangles in the actor's own axes,
    whose poses (N, 4, 4) are those of the rays' times; and the rays' unit directions (N, 3) in these axes.

    Triangles stay as they are: rays are taken into their metres, where the scale is divided out; distances
    are the world's.
    """
    inverse = np.swapaxes(poses[:, :3, :3], 1, 2)
    o = np.einsum("nij,nj->ni", inverse, origins - poses[:, :3, 3])
    d = np.einsum("nij,nj->ni", inverse, directions)
    if not actor.is_scaled:
        return triangles.first_hits(o, d, near_m), d
    scale = np.array(actor.scale)
    o, d = (o + near_m * d) / scale, d / scale
    stretch = np.linalg.norm(d, axis=1)
    d /= stretch[:, None]
    hits = triangles.first_hits(o, d, 0.0)
    return FirstHits(near_m + hits.t / stretch, hits.face, hits.uv), d


def normals_of(actor: Actor, poses: FloatArray, normals: FloatArray) -> FloatArray:
    """Return unit normals (N, 3), world frame, of normals (N, 3) in the actor's own axes, by poses (N, 4, 4) and the
    inverse of the scale."""
    if actor.is_scaled:
        normals = normals / np.array(actor.scale)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.einsum("nij,nj->ni", poses[:, :3, :3], normals)


NODE = np.dtype([("low", np.float32, 3), ("first", np.int32), ("high", np.float32, 3), ("faces", np.int32)])
"""`unisim_bvh_node` of native/unisim_native.h."""
PAIRS = 1 << 20
"""Number of pairs of ray and triangle that the numpy reference tests at once."""


DEEPEST = 100
"""Largest number of levels of a hierarchy; the kernel walks through 128."""


class FirstHits(NamedTuple):
    """First hits of rays: t (N,) along the ray, inf where it hits nothing; face (N,), -1 for none; uv (N, 2), the
    weights of the face's second and third corner."""

    t: FloatArray
    face: NDArray[np.int32]
    uv: NDArray[np.float32]


class Triangles:
    """Triangles, vertices (V, 3) float32 and faces (F, 3) int32, with the hierarchy of boxes for rays. ``boxes``, nodes
    and order, may be given from an earlier build of the same triangles. Raises `ScenarioError` for invalid faces."""

    def __init__(
        self,
        vertices: NDArray[np.float32],
        faces: NDArray[np.int32],
        boxes: tuple[NDArray[Any], NDArray[np.int32]] | None = None,
    ) -> None:
        self.vertices = np.ascontiguousarray(vertices, np.float32)
        self.faces = np.ascontiguousarray(faces, np.int32)
        check_faces(self.vertices, self.faces)  # kernels read wherever faces point
        self.boxes = boxes
        lib = native.library()
        if lib is not None and boxes is None and len(self.faces):
            order, nodes = np.empty(len(self.faces), np.int32), np.empty(2 * len(self.faces), NODE)
            pointers = (x.ctypes.data for x in (self.vertices, self.faces))
            used = lib.unisim_bvh_build(*pointers, len(self.faces), nodes.ctypes.data, order.ctypes.data)
            self.boxes = nodes[:used].copy(), order

    def first_hits(self, origins: FloatArray, directions: FloatArray, near_m: float) -> FirstHits:
        """Return the first hits beyond ``near_m`` of rays, origins and unit directions (N, 3), in the triangles'
        axes."""
        assert origins.shape == directions.shape == (len(origins), 3), (origins.shape, directions.shape)
        lib = native.library()
        if lib is None or self.boxes is None:
            return first_hits_reference(self, origins, directions, near_m)
        o, d = np.ascontiguousarray(origins, np.float64), np.ascontiguousarray(directions, np.float64)
        t, face, uv = np.empty(len(o)), np.empty(len(o), np.int32), np.empty((len(o), 2), np.float32)
        out = (x.ctypes.data for x in (t, face, uv))
        mesh = (x.ctypes.data for x in (*self.boxes, self.vertices, self.faces, o, d))
        lib.unisim_bvh_first_hits(*mesh, len(o), near_m, *out, native.threads())
        return FirstHits(t, face, uv)


def check_boxes(nodes: NDArray[Any], order: NDArray[Any], faces: int) -> None:
    """Raise ValueError unless nodes and order are a hierarchy over ``faces`` faces: kernels follow its indices
    unchecked."""
    if nodes.dtype != NODE or nodes.ndim != 1 or order.dtype != np.int32 or order.shape != (faces,) or not len(nodes):
        raise ValueError("is no hierarchy of boxes")
    if len(order) and not 0 <= int(order.min()) <= int(order.max()) < faces:
        raise ValueError("the hierarchy names a face that is not there")
    first, count = nodes["first"], nodes["faces"]
    leaf = count != 0
    # no sum of the two, which may be beyond int32
    if (
        (count < 0).any()
        or (first < 0).any()
        or (np.where(leaf, count, 2) > np.where(leaf, faces, len(nodes)) - first).any()
    ):
        raise ValueError("the hierarchy points beyond its end")
    level, walked = np.zeros(1, np.int64), 0
    for _ in range(DEEPEST):
        walked += len(level)
        inner = level[~leaf[level]]
        if not len(inner):
            return
        level = np.concatenate([first[inner], first[inner] + 1])
        if walked + len(level) > len(nodes):
            break
    raise ValueError("the hierarchy has no end")


class Mesh(Triangles):
    """A model with its hierarchy of boxes for rays."""

    def __init__(self, model: MeshModel) -> None:
        super().__init__(model.vertices, model.faces)
        self.model = model


@lru_cache(maxsize=16)
def ready(model: MeshModel) -> Mesh:
    """Return the model's `Mesh`, built once."""
    return Mesh(model)


def first_hits_reference(
    mesh: MeshModel | Triangles, origins: FloatArray, directions: FloatArray, near_m: float
) -> FirstHits:
    """`Triangles.first_hits` in numpy, every ray against every triangle (Moeller and Trumbore, 1997)."""
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    t = np.full(len(origins), np.inf)
    face = np.full(len(origins), -1, np.int32)
    uv = np.zeros((len(origins), 2), np.float32)
    if len(a) == 0:
        return FirstHits(t, face, uv)
    step = max(1, PAIRS // len(a))
    for begin in range(0, len(origins), step):
        part = slice(begin, begin + step)
        o, d = origins[part, None], directions[part, None]
        p = np.cross(d, ac)
        det = (ab * p).sum(-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = o - a
            u = (s * p).sum(-1) / det
            q = np.cross(s, ab)
            v = (d * q).sum(-1) / det
            at = (ac * q).sum(-1) / det
        with np.errstate(invalid="ignore"):
            inside = (det != 0) & (u >= 0) & (u <= 1) & (v >= 0) & (u + v <= 1) & (at > near_m)
        at = np.where(inside, at, np.inf)
        first = at.argmin(1)
        rows = np.arange(len(first))
        hit = np.isfinite(at[rows, first])
        t[part], face[part] = at[rows, first], np.where(hit, first, -1)
        uv[part] = np.where(hit[:, None], np.stack([u[rows, first], v[rows, first]], -1), 0)
    return FirstHits(t, face, uv)
