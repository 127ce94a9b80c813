"""Hits of rays on surfels: static ones, and sets that are placed at their poses at each ray's own time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....geometry import FloatArray
from ....meshes.hits import moments, near_actor
from ....meshes.intersect import first_hits_on, normals_of
from ....sensors.bounds import Bounds
from ....sensors.rays import Rays
from ....world.drive import Actor
from .model import SurfelSet

STATIC_OWNER = -1
"""The owner of what stands still; `NO_OWNER` where nothing was hit."""
NO_OWNER = -2
BUNDLE_RAYS = 1 << 13


@dataclass(frozen=True)
class SurfelHits:
    """Hits of rays, (N,) each: t, metres, inf where nothing is hit; owner, a number of the placed sets, `STATIC_OWNER`
    or `NO_OWNER`; face, an index of the owner's; uv (N, 2), the weights of the face's second and third corner."""

    t: FloatArray
    owner: NDArray[np.int64]
    face: NDArray[np.int64]
    uv: NDArray[np.float32]


class PlacedSurfels:
    """A static set, and sets that move with actors, present in their windows."""

    def __init__(self, static: SurfelSet, placed: Sequence[tuple[Actor, SurfelSet]] = ()) -> None:
        self.static, self.placed = static, tuple(placed)
        self._bounds = Bounds([actor for actor, _ in self.placed])

    def owned(self, owner: int) -> SurfelSet:
        return self.static if owner == STATIC_OWNER else self.placed[owner][1]

    def first(self, rays: Rays, near_m: float) -> SurfelHits:
        """Return the first hits of flat rays (N,) beyond ``near_m``."""
        hits = self.static.triangles.first_hits(rays.origins, rays.directions, near_m)
        t, face, uv = hits.t.copy(), hits.face.astype(np.int64), hits.uv.copy()
        owner = np.where(hits.face >= 0, STATIC_OWNER, NO_OWNER)
        # rays that go the same way together: few actors are in reach of each bundle
        order = np.argsort(np.arctan2(rays.directions[:, 1], rays.directions[:, 0]), kind="stable")
        for begin in range(0, len(order) if self.placed else 0, BUNDLE_RAYS):
            part = order[begin : begin + BUNDLE_RAYS]
            bundle = rays.part(part)
            times, which = moments(bundle)
            for number in self._bounds.in_reach(bundle):
                actor, faces = self.placed[number]
                poses = actor.world_from_actor.at(times)
                mine = np.flatnonzero(near_actor(actor, poses, which, bundle, 0.0))
                if len(mine) == 0 or len(faces) == 0:
                    continue
                pose = poses[which[mine]]
                own, _ = first_hits_on(
                    actor, faces.triangles, pose, bundle.origins[mine], bundle.directions[mine], near_m
                )
                nearer = (own.face >= 0) & (own.t < t[part[mine]])
                at = part[mine[nearer]]
                t[at], owner[at], face[at], uv[at] = own.t[nearer], number, own.face[nearer], own.uv[nearer]
        return SurfelHits(t, owner, face, uv)

    def gathered(self, hits: SurfelHits, name: str, width: tuple[int, ...], kind: type) -> NDArray[Any]:
        """Return an attribute (N, *width) of the faces that were hit; 0 where none was."""
        out: NDArray[Any] = np.zeros((len(hits.t), *width), kind)
        for owner in np.unique(hits.owner):
            if owner != NO_OWNER:
                mine = hits.owner == owner
                out[mine] = getattr(self.owned(int(owner)), name)[hits.face[mine]]
        return out

    def colours(self, hits: SurfelHits) -> NDArray[np.float32]:
        """Return colours (N, 3) in 0..1, interpolated between the corners' where rays hit."""
        corners = self.gathered(hits, "colours", (3, 3), np.float32)
        u, v = hits.uv[:, :1], hits.uv[:, 1:]
        return np.asarray((corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v) / 255, np.float32)

    def normals(self, hits: SurfelHits, rays: Rays) -> FloatArray:
        """Return unit normals (N, 3), world frame, on the rays' side; 0 where nothing was hit."""
        normals = self.gathered(hits, "normals", (3,), np.float64)
        for owner in np.unique(hits.owner):
            if owner >= 0:
                mine = np.flatnonzero(hits.owner == owner)
                normals[mine] = turned(self.placed[owner][0], rays.time_s[mine], normals[mine])
        against = np.einsum("ni,ni->n", normals, rays.directions) > 0
        return np.where(against[:, None], -normals, normals)


def turned(actor: Actor, time_s: FloatArray, normals: FloatArray) -> FloatArray:
    """Return unit normals (N, 3), world frame at times (N,), of normals (N, 3) in an actor's own axes."""
    times, which = np.unique(time_s, return_inverse=True)
    return normals_of(actor, actor.world_from_actor.at(times)[which.reshape(-1)], normals)


def carried(actor: Actor, time_s: FloatArray, points: FloatArray, back: bool = False) -> FloatArray:
    """Return points (N, 3), world frame at times (N,), of points (N, 3) in an actor's own axes and unscaled metres;
    ``back``: the inverse."""
    times, which = np.unique(time_s, return_inverse=True)
    pose = actor.world_from_actor.at(times)[which.reshape(-1)]
    if back:
        local = np.einsum("nji,nj->ni", pose[:, :3, :3], points - pose[:, :3, 3])
        return local / np.array(actor.scale) if actor.is_scaled else local
    if actor.is_scaled:
        points = points * np.array(actor.scale)
    return np.einsum("nij,nj->ni", pose[:, :3, :3], points) + pose[:, :3, 3]
