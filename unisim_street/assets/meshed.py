"""A street of triangles: what the exact street's solids are when a path tracer draws them, and LiDAR hits
the same triangles.

Solids become their triangles, crowns leaves, cars of hulls cars with curved bodies; names, places and
paint are the same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..tracing.shapes import Spheres, box
from ..tracing.trace import Asset, AssetPart
from ..tracing.triangles import TracedTriangles, quads
from .cars import BodyPaint
from .coachwork import coachwork
from .leaves import leaves
from .road import GROUND_REACH_M, HALF_ROAD_M, HALF_STREET_M, KERB_M, PavementPaint, RoadPaint, RoadPlan
from .tessellate import tessellated

_TILE_M = 20.0
_PAVEMENT_FAR_M = 70.0


def meshed(asset: Asset) -> Asset:
    """The asset of triangles."""
    if isinstance(asset.parts[0].material, BodyPaint):
        return coachwork(asset)
    return Asset(asset.name, tuple(_meshed_part(part) for part in asset.parts))


def _meshed_part(part: AssetPart) -> AssetPart:
    shape = leaves(part.shape) if isinstance(part.shape, Spheres) else tessellated(part.shape)
    return AssetPart(shape, part.material, part.asset_from_part)


def meshed_ground(plan: RoadPlan) -> Asset:
    """The ground: carriageway and pavements in tiles, so that each has its own detail, and the kerbs. What no camera in
    the street sees, under the houses and beyond the street, is of one colour."""
    parts = []
    for x0, x1 in _tiles(plan.start_x, plan.crossing[0], plan.crossing[1], plan.end_x):
        parts.append(_road(plan, x0, x1, (-HALF_ROAD_M, HALF_ROAD_M)))
    reach, far = GROUND_REACH_M, _PAVEMENT_FAR_M
    for side in (-1.0, 1.0):
        for near, beyond in ((HALF_ROAD_M, 20.0), (20.0, far)):
            parts.append(_road(plan, *plan.crossing, (side * near, side * beyond)))
        parts.append(_road(plan, plan.start_x, plan.end_x, (side * far, side * reach), speckled=True))
    for x0, x1 in ((-reach, plan.start_x), (plan.end_x, reach)):
        parts.append(_road(plan, x0, x1, (-reach, reach), speckled=True))
    for x0, x1 in ((plan.start_x, plan.crossing[0]), (plan.crossing[1], plan.end_x)):
        for side in (-1.0, 1.0):
            paint = PavementPaint((x0, x1), side)
            y0, y1 = sorted((side * HALF_ROAD_M, side * far))
            block = tessellated(box((x0, y0, -0.5), (x1, y1, KERB_M)))
            parts.append(AssetPart(TracedTriangles(block.corners[np.abs(block.face_normals[:, 2]) < 0.5]), paint))
            fronts = HALF_STREET_M + 1.0  # some houses stand back
            for a, b in _tiles(x0, x1):
                parts.append(AssetPart(_tile(a, b, (side * HALF_ROAD_M, side * fronts), KERB_M), paint))
            parts.append(AssetPart(_tile(x0, x1, (side * fronts, side * far), KERB_M, speckled=True), paint))
    return Asset("ground", tuple(parts))


def _tiles(*ends: float) -> list[tuple[float, float]]:
    """Stretches of some `_TILE_M` between each two ends."""
    cuts = [
        np.linspace(a, b, max(1, round((b - a) / _TILE_M)) + 1).tolist()
        for a, b in zip(ends[:-1], ends[1:], strict=True)
    ]
    return [pair for cut in cuts for pair in zip(cut[:-1], cut[1:], strict=True)]


def _road(plan: RoadPlan, x0: float, x1: float, y: tuple[float, float], speckled: bool = False) -> AssetPart:
    """A tile of carriageway; its paint knows the patches and manholes near it alone, which is as much as shows."""
    room = 1.0
    patches = tuple(p for p in plan.patches if x0 - room < p[0] + p[2] and p[0] - p[2] < x1 + room)
    manholes = tuple(m for m in plan.manholes if x0 - room < m[0] < x1 + room)
    return AssetPart(_tile(x0, x1, y, 0.0, speckled), RoadPaint(replace(plan, patches=patches, manholes=manholes)))


def _tile(x0: float, x1: float, y: tuple[float, float], z: float, speckled: bool = False) -> TracedTriangles:
    y0, y1 = sorted(y)
    corners = (np.array([[x, y, z]]) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1)))
    return TracedTriangles(quads(*corners), speckled=speckled)
