"""The first triangle on each ray: by the compiled hierarchy of boxes, or one triangle after the other where it is absent."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..geometry import FloatArray
from .model import MeshModel

NODE = np.dtype([("low", np.float32, 3), ("first", np.int32), ("high", np.float32, 3), ("faces", np.int32)])
"""`unisim_bvh_node` of native/unisim_native.h."""
PAIRS = 1 << 20
"""Rays times triangles that the plain way looks at together."""


class FirstHits(NamedTuple):
    """t (N,) along each ray, inf where it meets nothing; face (N,), -1 for none; uv (N, 2), where on the face: towards its second
    and third corner."""

    t: FloatArray
    face: NDArray[np.int32]
    uv: NDArray[np.float32]


class Mesh:
    """A model that is ready to be met by rays."""

    def __init__(self, model: MeshModel) -> None:
        self.model = model
        self.vertices = np.ascontiguousarray(model.vertices, np.float32)
        self.faces = np.ascontiguousarray(model.faces, np.int32)
        lib = native.library()
        if lib is not None:
            self.order = np.empty(len(self.faces), np.int32)
            self.nodes = np.empty(2 * len(self.faces), NODE)
            pointers = (x.ctypes.data for x in (self.vertices, self.faces))
            used = lib.unisim_bvh_build(*pointers, len(self.faces), self.nodes.ctypes.data, self.order.ctypes.data)
            self.nodes = self.nodes[:used].copy()

    def first_hits(self, origins: FloatArray, directions: FloatArray, near_m: float) -> FirstHits:
        """What rays (N, 3) with unit directions, in the model's axes, meet first beyond ``near_m``."""
        lib = native.library()
        if lib is None:
            return first_hits_reference(self.model, origins, directions, near_m)
        o, d = np.ascontiguousarray(origins, np.float64), np.ascontiguousarray(directions, np.float64)
        t, face, uv = np.empty(len(o)), np.empty(len(o), np.int32), np.empty((len(o), 2), np.float32)
        mesh = (self.nodes, self.order, self.vertices, self.faces, o, d)
        out = (x.ctypes.data for x in (t, face, uv))
        lib.unisim_bvh_first_hits(*(x.ctypes.data for x in mesh), len(o), near_m, *out, native.threads())
        return FirstHits(t, face, uv)


@lru_cache(maxsize=16)
def ready(model: MeshModel) -> Mesh:
    """The model's `Mesh`, made once."""
    return Mesh(model)


def first_hits_reference(model: MeshModel, origins: FloatArray, directions: FloatArray, near_m: float) -> FirstHits:
    """`Mesh.first_hits`, every ray against every triangle (Moeller and Trumbore, 1997)."""
    corners = model.vertices.astype(np.float64)[model.faces]
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    t, face, uv = np.full(len(origins), np.inf), np.full(len(origins), -1, np.int32), np.zeros((len(origins), 2), np.float32)
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
            met = (det != 0) & (u >= 0) & (u <= 1) & (v >= 0) & (u + v <= 1) & (at > near_m)
        at = np.where(met, at, np.inf)
        first = at.argmin(1)
        rows = np.arange(len(first))
        hit = np.isfinite(at[rows, first])
        t[part], face[part] = at[rows, first], np.where(hit, first, -1)
        uv[part] = np.where(hit[:, None], np.stack([u[rows, first], v[rows, first]], -1), 0)
    return FirstHits(t, face, uv)
