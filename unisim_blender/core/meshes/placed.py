"""Triangles that go along with an actor, hit where the actor is and as large as it is."""

from __future__ import annotations

import numpy as np

from ..geometry import FloatArray
from ..world.drive import Actor
from .intersect import FirstHits, Triangles


def first_hits_on(
    actor: Actor, triangles: Triangles, poses: FloatArray, origins: FloatArray, directions: FloatArray, near_m: float
) -> tuple[FirstHits, FloatArray]:
    """What rays (N, 3) with unit directions hit first beyond ``near_m`` of triangles in the actor's own axes, whose
    poses (N, 4, 4) are those of the rays' times; and the rays' unit directions (N, 3) in these axes.

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
    """Unit normals (N, 3) of triangles in the actor's own axes, in the world: through the inverse of the scale."""
    if actor.is_scaled:
        normals = normals / np.array(actor.scale)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.einsum("nij,nj->ni", poses[:, :3, :3], normals)
