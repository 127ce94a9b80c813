"""A street of triangles: what the exact street's solids are when a path tracer draws them, and LiDAR hits
the same triangles.

Solids become their triangles, crowns leaves, cars of hulls cars with curved bodies; names, places and
paint are the same. A car of hulls is lofted in the style that `cars` gives it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from unisim_blender.core.geometry import FloatArray

from ..tracing.shapes import Cone, Convex, Ellipsoid, Spheres, TracedShape, TracedTriangles, box, grid, joined, quads
from ..tracing.trace import Asset, AssetPart
from .cars import BodyPaint, CabinPaint, Style, WheelPaint
from .facade import Facade
from .road import (
    GROUND_REACH_M,
    HALF_ROAD_WIDTH_M,
    HALF_STREET_WIDTH_M,
    KERB_HEIGHT_M,
    PavementPaint,
    RoadPaint,
    RoadPlan,
)

_TILE_M = 20.0
_PAVEMENT_FAR_M = 70.0


def meshed(asset: Asset) -> Asset:
    """The asset of triangles."""
    if isinstance(asset.parts[0].material, BodyPaint):
        return coachwork(asset)
    limbs = tuple(replace(limb, asset=meshed(limb.asset)) for limb in asset.limbs)
    return replace(asset, parts=tuple(_meshed_part(part) for part in asset.parts), limbs=limbs)


def _meshed_part(part: AssetPart) -> AssetPart:
    shape = leaves(part.shape) if isinstance(part.shape, Spheres) else tessellated(part.shape)
    return AssetPart(shape, part.material, part.asset_from_part)


def meshed_ground(plan: RoadPlan) -> Asset:
    """The ground: carriageway and pavements in tiles, so that each has its own detail, and the kerbs. What no camera in
    the street sees, under the houses and beyond the street, is of one colour."""
    parts = []
    for x0, x1 in _tiles(plan.start_x, plan.crossing[0], plan.crossing[1], plan.end_x):
        parts.append(_road(plan, x0, x1, (-HALF_ROAD_WIDTH_M, HALF_ROAD_WIDTH_M)))
    reach, far = GROUND_REACH_M, _PAVEMENT_FAR_M
    for side in (-1.0, 1.0):
        for near, beyond in ((HALF_ROAD_WIDTH_M, 20.0), (20.0, far)):
            parts.append(_road(plan, *plan.crossing, (side * near, side * beyond)))
        parts.append(_road(plan, plan.start_x, plan.end_x, (side * far, side * reach), speckled=True))
    for x0, x1 in ((-reach, plan.start_x), (plan.end_x, reach)):
        parts.append(_road(plan, x0, x1, (-reach, reach), speckled=True))
    for x0, x1 in ((plan.start_x, plan.crossing[0]), (plan.crossing[1], plan.end_x)):
        for side in (-1.0, 1.0):
            paint = PavementPaint((x0, x1), side)
            y0, y1 = sorted((side * HALF_ROAD_WIDTH_M, side * far))
            block = tessellated(box((x0, y0, -0.5), (x1, y1, KERB_HEIGHT_M)))
            parts.append(AssetPart(TracedTriangles(block.corners[np.abs(block.face_normals[:, 2]) < 0.5]), paint))
            fronts = HALF_STREET_WIDTH_M + 1.0  # some houses stand back
            for a, b in _tiles(x0, x1):
                parts.append(AssetPart(_tile(a, b, (side * HALF_ROAD_WIDTH_M, side * fronts), KERB_HEIGHT_M), paint))
            parts.append(AssetPart(_tile(x0, x1, (side * fronts, side * far), KERB_HEIGHT_M, speckled=True), paint))
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


_SIDES_OF_ROUNDS = 28
"""Sides of what is round."""


def tessellated(shape: TracedShape) -> TracedTriangles:
    """The triangles of a solid; what is round has sides that lie within it."""
    if isinstance(shape, TracedTriangles):
        return shape
    if isinstance(shape, Facade):
        return _facade(shape)
    if isinstance(shape, Convex):
        return _convex(shape)
    if isinstance(shape, Cone):
        return revolved(np.array([(0.0, 0.0), (shape.r0, 0.0), (shape.r1, shape.height), (0.0, shape.height)]))
    if isinstance(shape, Ellipsoid):
        turn = np.linspace(-np.pi / 2, np.pi / 2, 13)
        ball = revolved(np.stack([np.cos(turn), np.sin(turn)], 1))
        normals = ball.corners / shape.radii
        return TracedTriangles(ball.corners * shape.radii, normals / np.linalg.norm(normals, axis=-1, keepdims=True))
    raise TypeError(f"{type(shape).__name__} has no triangles")


def revolved(profile: FloatArray, sides: int = _SIDES_OF_ROUNDS) -> TracedTriangles:
    """Return the surface of revolution of a profile (P, 2) of radii and heights about z, its outside to the profile's
    right; edges of it stay sharp."""
    turn = 2 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(turn), np.sin(turn)], -1)
    rings = np.concatenate(
        [profile[:, None, :1] * circle, np.broadcast_to(profile[:, None, 1:], (len(profile), sides, 1))], -1
    )
    return grid(rings.swapaxes(0, 1)[np.r_[0:sides, 0]])


def _convex(shape: Convex) -> TracedTriangles:
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    corners = HalfspaceIntersection(np.column_stack([shape.planes, -shape.offsets]), shape.middle).intersections
    corners = np.unique(np.round(corners, 7), axis=0)
    hull = ConvexHull(corners)
    faces, out = corners[hull.simplices], hull.equations[:, :3]
    turned = (np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]) * out).sum(1) < 0
    faces[turned] = faces[turned][:, ::-1]
    return TracedTriangles(faces)


def _facade(shape: Facade) -> TracedTriangles:
    """The block's faces, the front with its openings cut out, and each opening's back and cheeks."""
    w, d, h = shape.width, shape.depth, shape.height
    front: list[tuple[float, float, float, float]] = []  # x and z from, to
    faces: list[FloatArray] = []
    z = 0.0
    for storey in shape.storeys:
        if storey.count == 0:
            continue
        front.append((0.0, w, z, storey.low))
        left = storey.first + storey.pitch * np.arange(storey.count)
        edges = np.concatenate([[0.0], np.stack([left, left + storey.width], 1).reshape(-1), [w]])
        front += [(edges[i], edges[i + 1], storey.low, storey.high) for i in range(0, len(edges), 2)]
        for x0, x1 in zip(edges[1:-1:2], edges[2:-1:2], strict=True):
            faces += _recess(float(x0), float(x1), storey.low, storey.high, storey.depth)
        z = storey.high
    front.append((0.0, w, z, h))
    x0, x1, z0, z1 = np.array([piece for piece in front if piece[1] > piece[0] and piece[3] > piece[2]]).T
    o = np.zeros_like(x0)
    faces.append(quads(*(np.stack(c, 1) for c in ((x0, o, z0), (x1, o, z0), (x1, o, z1), (x0, o, z1)))))
    corner = np.array(
        [(0, 0, 0), (w, 0, 0), (w, d, 0), (0, d, 0), (0, 0, h), (w, 0, h), (w, d, h), (0, d, h)], np.float64
    )
    for a, b, c, e in ((1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7), (3, 2, 1, 0)):
        faces.append(quads(*(corner[None, i] for i in (a, b, c, e))))
    return TracedTriangles(np.concatenate(faces))


def _recess(x0: float, x1: float, z0: float, z1: float, depth: float) -> list[FloatArray]:
    """Back and four cheeks of an opening."""
    p = {
        (i, j, k): np.array([[(x0, x1)[i], (0.0, depth)[j], (z0, z1)[k]]])
        for i in (0, 1)
        for j in (0, 1)
        for k in (0, 1)
    }
    sides = (
        ((0, 1, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1)),  # the back, which looks out
        ((0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)),
        ((1, 1, 0), (1, 0, 0), (1, 0, 1), (1, 1, 1)),
        ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)),
        ((0, 1, 1), (1, 1, 1), (1, 0, 1), (0, 0, 1)),
    )
    return [quads(*(p[corner] for corner in side)) for side in sides]


_STATION_SPACING_M = 0.045
"""Spacing of a body's stations."""
_WHEEL_M = 0.22


def coachwork(hulls: Asset) -> Asset:
    """The car of hulls with a curved body, cabin and wheels; what it carries and its mirrors as they are."""
    body, cabin = hulls.parts[0].material, hulls.parts[1].material
    assert isinstance(body, BodyPaint) and isinstance(cabin, CabinPaint)
    parts = [AssetPart(_body(body.style), body), AssetPart(_cabin(cabin.style), cabin)]
    for part in hulls.parts[2:]:
        shape = _wheel(part.material.radius) if isinstance(part.material, WheelPaint) else tessellated(part.shape)
        parts.append(AssetPart(shape, part.material, part.asset_from_part))
    return Asset(hulls.name, tuple(parts))


@lru_cache
def _body(s: Style) -> TracedTriangles:
    """Lower body: sections across the length, rounded in plan and profile, the wheels' wells pressed in."""
    half, c = s.length / 2, s.cabin
    x = np.linspace(-half, half, round(s.length / _STATION_SPACING_M))
    # stations crowd together where the ends turn round
    x = half * np.sign(x) * (1 - (1 - np.abs(x) / half) ** 1.15)
    low = 0.20 if s.height < 1.9 else 0.28
    front, rear = np.clip((x - half + 0.55) / 0.55, 0, 1), np.clip((-x - half + 0.45) / 0.45, 0, 1)
    ends = np.maximum(front, rear)
    bonnet = np.clip((x - c.front_foot + 0.25) / (half - 0.12 - c.front_foot + 0.25), 0, 1)
    boot = np.clip((-x + c.rear_foot + 0.3) / max(half + c.rear_foot + 0.3 - 0.1, 0.15), 0, 1)
    top = s.belt + (s.nose - s.belt) * bonnet**1.6 + (s.tail - s.belt) * boot**1.5
    top = top - 0.30 * (s.nose - 0.45) * front**4 - 0.16 * (s.tail - 0.45) * rear**4
    bottom = low + 0.14 * ends**2
    width = s.half_width * (1 - 0.24 * front**2.6 - 0.17 * rear**2.8)
    turn = np.linspace(0, 2 * np.pi, 72, endpoint=False) + 0.01
    power = 2 / 4.6
    across = np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** power
    up = np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** power
    z = (top + bottom)[:, None] / 2 + (top - bottom)[:, None] / 2 * up
    # flanks lean in above the widest line and tuck under below
    lean = (
        1
        - 0.09 * np.clip((z - 0.62) / (s.belt - 0.62 + 1e-6), 0, 1.2) ** 2
        - 0.06 * np.clip((0.5 - z) / 0.3, 0, 1) ** 2
    )
    y = width[:, None] * across * lean
    points = np.stack([np.broadcast_to(x[:, None], y.shape), y, z], -1)
    points = _with_wells(points, s)
    caps = np.stack([points[0].mean(0), points[-1].mean(0)])
    points = np.concatenate([np.repeat(caps[:1, None], len(turn), 1), points, np.repeat(caps[1:, None], len(turn), 1)])
    points[..., 2] -= s.height / 2
    return _outward(points)


def _with_wells(points: FloatArray, s: Style) -> FloatArray:
    """Points of the flanks within a wheel's arch pressed in behind the wheel; those next to its edge moved onto it."""
    out = points.copy()
    for axle in s.axles:
        off = out[..., [0, 2]] - [axle, s.wheel_radius]
        away = np.maximum(np.linalg.norm(off, axis=-1), 1e-9)
        reach = 1.14 * s.wheel_radius
        flank = np.abs(out[..., 1]) > 0.55 * s.half_width
        edge = flank & (away >= reach) & (away < reach + 0.6 * _STATION_SPACING_M)
        moved = [axle, s.wheel_radius] + off * (reach / away)[..., None]
        out[..., 0] = np.where(edge, moved[..., 0], out[..., 0])
        out[..., 2] = np.where(edge, moved[..., 1], out[..., 2])
        inside = flank & (away < reach)
        out[..., 1] = np.where(inside, np.sign(out[..., 1]) * (s.half_width - _WHEEL_M - 0.06), out[..., 1])
    return out


@lru_cache
def _cabin(s: Style) -> TracedTriangles:
    """Rings from belt to roof, then a roof that is a little domed."""
    c = s.cabin
    turn = np.linspace(0, 2 * np.pi, 88, endpoint=False) + 0.01
    tall = s.height - s.belt
    rise = np.concatenate([np.linspace(-0.06, 0.90, 13), [0.945, 0.975, 0.990, 1.0, 1.0, 1.0]])
    shrink = np.concatenate([np.ones(13), [0.985, 0.95, 0.88, 0.72, 0.4, 0.0]])
    power = 2 / 5.5
    along = np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** power
    across = np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** power
    r = np.clip(rise, 0, 0.945)[:, None]
    front = c.front_foot + r * (c.front_head - c.front_foot)
    rear = c.rear_foot + r * (c.rear_head - c.rear_foot)
    half_y = c.foot_half + r * (c.roof_half - c.foot_half)
    middle, half_x = (front + rear) / 2, (front - rear) / 2
    bulge = 1 - 0.05 * np.abs(across) ** 3  # screens are curved in plan
    x = middle + half_x * shrink[:, None] * along * bulge
    y = half_y * shrink[:, None] * across
    z = np.broadcast_to((s.belt + tall * rise - s.height / 2)[:, None], x.shape)
    return _outward(np.stack([x, y, z], -1))


def _outward(rings: FloatArray) -> TracedTriangles:
    """Rings (R, C, 3) as a smooth surface; each is counter-clockwise as seen from where the last one is."""
    return grid(rings.swapaxes(0, 1)[np.r_[0 : rings.shape[1], 0]])


@lru_cache
def _wheel(radius: float) -> TracedTriangles:
    """Tyre and rim: their profile turned about the axle, which is the part's z."""
    w, r = _WHEEL_M, radius
    tyre = [
        (0.72 * r, w - 0.012),
        (0.90 * r, w),
        (0.97 * r, w - 0.015),
        (r, w - 0.05),
        (r, 0.04),
        (0.95 * r, 0.0),
        (0.0, 0.0),
    ]
    rim = [
        (0.0, w - 0.02),
        (0.14 * r, w - 0.02),
        (0.24 * r, w - 0.045),
        (0.60 * r, w - 0.05),
        (0.69 * r, w - 0.008),
        (0.72 * r, w - 0.012),
    ]
    return joined([revolved(np.array(p)[::-1], 36) for p in (tyre, rim)])


_LEAVES_PER_M2 = 50.0
"""Leaves for each square metre of a clump's sphere."""
_LEAF_LENGTH_M, _LEAF_WIDTH_M = 0.17, 0.085


def leaves(clumps: Spheres) -> TracedTriangles:
    """Leaves in and on the clumps, each two triangles folded along its rib; the same clumps give the same leaves."""
    rng = np.random.default_rng(np.abs(np.rint(clumps.centers[0] * 1e6)).astype(np.int64))
    count = np.maximum(4, (4 * np.pi * clumps.radii**2 * _LEAVES_PER_M2).astype(int))
    center, radius = np.repeat(clumps.centers, count, 0), np.repeat(clumps.radii, count)[:, None]
    n = len(center)
    out = _unit(rng.standard_normal((n, 3)))
    place = center + out * radius * rng.uniform(0.55, 1.05, (n, 1))
    # a leaf looks up and out of its crown, more or less
    crown = (clumps.low + clumps.high) / 2
    face = _unit(_unit(place - crown) + [0.0, 0.0, 0.6] + 0.8 * rng.standard_normal((n, 3)))
    rib = _unit(np.cross(face, rng.standard_normal((n, 3))))
    side = np.cross(face, rib)
    size = rng.uniform(0.7, 1.25, (n, 1))
    long, wide = _LEAF_LENGTH_M / 2 * size * rib, _LEAF_WIDTH_M / 2 * size * side
    lift = 0.012 * size * face
    base, tip, left, right = place - long, place + long, place + wide + lift, place - wide + lift
    return TracedTriangles(
        np.stack([np.stack([base, tip, left], 1), np.stack([base, right, tip], 1)], 1).reshape(-1, 3, 3), speckled=True
    )


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
