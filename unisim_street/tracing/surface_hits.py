"""Points, normals and surfaces of hits, and names of what was hit that stay the same through edits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray

from ..paint.materials import SurfacePoints
from .trace import AssetPlacement, Hits, into_asset


@dataclass(frozen=True)
class Surfaces:
    """Surface points that N rays hit, in the order of the flat rays ``rays`` (N,).

    points, normals, soft_normals (N, 3) world; local (N, 3) in the asset's own frame, which moves with an actor and
    stays with what was copied; albedo, emitted (N, 3); gloss, glass, reflectivity, cosine (N,); placement, part (N,) numbers.
    """

    rays: NDArray[np.int64]
    points: FloatArray
    normals: FloatArray
    soft_normals: FloatArray
    local: FloatArray
    albedo: FloatArray
    emitted: FloatArray
    gloss: FloatArray
    glass: FloatArray
    reflectivity: FloatArray
    cosine: FloatArray
    placement: NDArray[np.int16]
    part: NDArray[np.int16]


def look_up(
    placements: list[AssetPlacement],
    hits: Hits,
    origins: FloatArray,
    directions: FloatArray,
    time_s: FloatArray,
    footprint_rad: float,
    painted: bool = True,
) -> Surfaces:
    """The surfaces that rays (M, 3), (M, 3) at times (M,) hit; a ray covers ``footprint_rad``. Colours stay
    0 unless painted."""
    t = hits.t.reshape(-1)
    rays = np.flatnonzero(np.isfinite(t))
    placement, part = hits.placement.reshape(-1)[rays], hits.part.reshape(-1)[rays]
    order = np.argsort(placement.astype(np.int32) * 32768 + part, kind="stable")
    rays, placement, part = rays[order], placement[order], part[order]
    o, d, t = origins[rays], directions[rays], t[rays]
    n = len(rays)
    normals, soft, local, albedo, emitted = (np.zeros((n, 3)) for _ in range(5))
    gloss, glass, reflectivity, cosine = (np.zeros(n) for _ in range(4))
    key = placement.astype(np.int32) * 32768 + part
    starts = np.flatnonzero(np.diff(key, prepend=-1))
    for start, end in zip(starts, np.append(starts, n)[1:], strict=True):
        some = slice(start, end)
        place = placements[placement[start]]
        solid = place.asset.parts[part[start]]
        ao, ad, stretch = into_asset(place, o[some], d[some], time_s[rays[some]])
        along = t[some] if stretch is None else t[some] * stretch
        po, pd = solid.to_part(ao, ad)
        in_asset, in_part = ao + along[:, None] * ad, po + along[:, None] * pd
        normal, rounded = solid.shape.faced(in_part, pd)
        cosine[some] = np.abs((pd * normal).sum(-1))
        if painted:
            footprint, seen_s = along * footprint_rad, time_s[rays[some]]
            paint = solid.material(SurfacePoints(in_part, in_asset, normal, footprint, cosine[some], seen_s))
            if paint.emitted is not None:
                emitted[some] = paint.emitted
            albedo[some], gloss[some], glass[some], reflectivity[some] = (
                paint.albedo,
                paint.gloss,
                paint.glass,
                paint.reflectivity,
            )
        if solid.asset_from_part is not None:
            normal, rounded = normal @ solid.asset_from_part[:3, :3].T, rounded @ solid.asset_from_part[:3, :3].T
        if place.scale is not None:
            normal, rounded = _unit(normal / place.scale), _unit(rounded / place.scale)
        if place.motion is not None:
            normal, rounded = _turn(place, normal, time_s[rays[some]]), _turn(place, rounded, time_s[rays[some]])
        if place.scale is not None:
            cosine[some] = np.abs((d[some] * normal).sum(-1))
        normals[some], soft[some], local[some] = normal, rounded, in_asset
    return Surfaces(
        rays, o + t[:, None] * d, normals, soft, local, albedo, emitted, gloss, glass, reflectivity, cosine, placement,
        part,
    )  # fmt: skip


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12))


def _turn(placement: AssetPlacement, vectors: FloatArray, time_s: FloatArray) -> FloatArray:
    """Asset-frame vectors (N, 3) in the world at times (N,)."""
    assert placement.motion is not None
    if len(placement.motion.times_s) == 1:
        return np.asarray(vectors @ placement.motion.poses[0, :3, :3].T)
    times, which = np.unique(time_s, return_inverse=True)
    return np.asarray(np.einsum("nij,nj->ni", placement.motion.at(times)[which, :3, :3], vectors))
