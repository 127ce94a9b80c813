"""Shapes that rays hit, vectorised over rays: solids with closed-form intersections, and surfaces of triangles.

Each shape stands in its own frame. ``intersect`` gives, for rays (N, 3) with unit directions, the smallest t >= t_min
at which the ray is inside the solid or on its surface: t_min itself where it starts inside, inf where it never enters.
``normals`` gives the outward unit normals of surface points. `TracedTriangles` are surfaces,
which have no inside: a street drawn by a path tracer is made of them, so that LiDAR hits the same surface.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import BoolArray, FloatArray
from unisim_blender.core.meshes.intersect import Mesh
from unisim_blender.core.meshes.model import FLAT, MeshModel, face_normals

_TINY = 1e-12


def first_inside(near: FloatArray, far: FloatArray, t_min: FloatArray) -> FloatArray:
    """The first t >= t_min of the interval [near, far], inf where it is empty."""
    t = np.maximum(near, t_min)
    return np.where(t < far, t, np.inf)


def slab(origin: FloatArray, direction: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Interval (N,), (N,) in which ``origin + t direction`` lies between low and high."""
    safe = np.where(np.abs(direction) < _TINY, np.copysign(_TINY, direction), direction)
    a, b = (low - origin) / safe, (high - origin) / safe
    return np.minimum(a, b), np.maximum(a, b)


def _quadratic(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Interval in which a t^2 + 2 b t + c <= 0 with a > 0; empty (inf, -inf) without real roots."""
    discriminant = b * b - a * c
    root = np.sqrt(np.maximum(discriminant, 0.0))
    hit = discriminant >= 0
    return np.where(hit, (-b - root) / a, np.inf), np.where(hit, (-b + root) / a, -np.inf)


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), _TINY))


class TracedShape(ABC):
    """Shape that a ray can hit."""

    low: FloatArray
    high: FloatArray
    """Corners (3,) of the bounding box, in the shape's frame."""

    @abstractmethod
    def intersect(self, origins: FloatArray, directions: FloatArray, t_min: FloatArray) -> FloatArray:
        """First t (N,) of rays (N, 3), (N, 3) from t_min (N,) on."""

    @abstractmethod
    def faced(self, points: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit normals (N, 3) where rays of directions (N, 3) end at surface points (N, 3), and those to shade with."""


class Solid(TracedShape):
    """A shape with an inside."""

    @abstractmethod
    def normals(self, points: FloatArray) -> FloatArray:
        """Outward unit normals (N, 3) at surface points (N, 3)."""

    def soft_normals(self, points: FloatArray) -> FloatArray:
        """Normals to shade with: `normals`, save where a shape rounds its edges off for the eye."""
        return self.normals(points)

    def faced(self, points: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.normals(points), self.soft_normals(points)


class Convex(Solid):
    """The intersection of half-spaces ``normal . x <= offset``; ``vertices`` (V, 3) bound it.

    ``edge_m`` > 0 blends the normals of neighbouring faces over that distance when shading, as sheet metal's edges do.
    """

    def __init__(self, normals: FloatArray, offsets: FloatArray, vertices: FloatArray, edge_m: float = 0.0) -> None:
        lengths = np.linalg.norm(normals, axis=1)
        self.planes = np.asarray(normals, np.float64) / lengths[:, None]
        self.offsets = np.asarray(offsets, np.float64) / lengths
        self.low, self.high = np.min(vertices, 0), np.max(vertices, 0)
        self.middle = np.mean(vertices, 0)
        self.edge_m = edge_m

    def intersect(self, origins: FloatArray, directions: FloatArray, t_min: FloatArray) -> FloatArray:
        slope = self.planes @ directions.T  # (K, N): long rows, so that the reductions below run along memory
        gap = self.offsets[:, None] - self.planes @ origins.T
        t = gap / np.where(np.abs(slope) < _TINY, np.copysign(_TINY, slope), slope)
        near = np.where(slope < 0, t, -np.inf).max(0)
        far = np.where(slope < 0, np.inf, t).min(0)
        return first_inside(near, far, t_min)

    def distances(self, points: FloatArray) -> FloatArray:
        """Signed distances (N, K) to the planes, negative inside."""
        return np.asarray(points @ self.planes.T - self.offsets)

    def normals(self, points: FloatArray) -> FloatArray:
        return np.asarray(self.planes[self.distances(points).argmax(1)])

    def soft_normals(self, points: FloatArray) -> FloatArray:
        if self.edge_m <= 0:
            return self.normals(points)
        weight = np.exp(np.maximum(self.distances(points) / self.edge_m, -30.0))
        return _unit(weight @ self.planes)


def box(low: Sequence[float], high: Sequence[float], edge_m: float = 0.0) -> Convex:
    """An axis-aligned box from corner to corner."""
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    low_a, high_a = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return Convex(normals, np.concatenate([high_a, -low_a]), np.stack([low_a, high_a]), edge_m)


def hull(points: FloatArray, edge_m: float = 0.0) -> Convex:
    """The convex hull of points (V, 3)."""
    from scipy.spatial import ConvexHull

    points = np.asarray(points, np.float64)
    equations = np.unique(np.round(ConvexHull(points).equations, 9), axis=0)
    return Convex(equations[:, :3], -equations[:, 3], points, edge_m)


class Sector(Solid):
    """A part of a ring about z: between two radii, ``half_rad`` to each side of x (less than a right angle), from ``low_z`` to
    ``high_z``."""

    def __init__(self, inner: float, outer: float, half_rad: float, low_z: float, high_z: float) -> None:
        self.inner, self.outer, self.half_rad, self.z = inner, outer, half_rad, (low_z, high_z)
        reach = outer * np.sin(half_rad)
        self.low = np.array([inner * np.cos(half_rad), -reach, low_z])
        self.high = np.array([outer, reach, high_z])
        # outwards through its two straight sides
        self.sides = np.array([[-np.sin(half_rad), side * np.cos(half_rad)] for side in (1.0, -1.0)])

    def intersect(self, origins: FloatArray, directions: FloatArray, t_min: FloatArray) -> FloatArray:
        near, far = slab(origins[:, 2], directions[:, 2], *self.z)
        a = np.maximum((directions[:, :2] ** 2).sum(1), _TINY**2)
        b = (origins[:, :2] * directions[:, :2]).sum(1)
        square = (origins[:, :2] ** 2).sum(1)
        enter, leave = _quadratic(a, b, square - self.outer**2)
        near, far = np.maximum(near, enter), np.minimum(far, leave)
        for side in self.sides:
            slope, gap = directions[:, :2] @ side, -(origins[:, :2] @ side)
            t = gap / np.where(np.abs(slope) < _TINY, np.copysign(_TINY, slope), slope)
            near, far = np.where(slope < 0, np.maximum(near, t), near), np.where(slope < 0, far, np.minimum(far, t))
        t = np.maximum(near, t_min)
        if self.inner > 0:
            enter, leave = _quadratic(a, b, square - self.inner**2)
            t = np.where((t > enter) & (t < leave), leave, t)
        return np.where(t < far, t, np.inf)

    def normals(self, points: FloatArray) -> FloatArray:
        radius = np.hypot(points[:, 0], points[:, 1])
        outward = points[:, :2] / np.maximum(radius, _TINY)[:, None]
        flat = np.zeros((len(points), 1))
        up = np.broadcast_to([0.0, 0.0, 1.0], (len(points), 3))
        faces = [np.concatenate([outward, flat], 1), np.concatenate([-outward, flat], 1), up, -up]
        distances = [radius - self.outer, self.inner - radius, points[:, 2] - self.z[1], self.z[0] - points[:, 2]]
        for side in self.sides:
            faces.append(np.broadcast_to([*side, 0.0], (len(points), 3)))
            distances.append(points[:, :2] @ side)
        nearest = np.stack(distances).argmax(0)
        return np.asarray(np.stack(faces)[nearest, np.arange(len(points))])


class Cone(Solid):
    """A capped cylinder or truncated cone about z, from z = 0 (radius ``r0``) to ``height`` (radius ``r1``)."""

    def __init__(self, r0: float, r1: float, height: float) -> None:
        self.r0, self.r1, self.height = float(r0), float(r1), float(height)
        self.slope = (self.r1 - self.r0) / self.height
        r = max(self.r0, self.r1)
        self.low, self.high = np.array([-r, -r, 0.0]), np.array([r, r, self.height])

    def intersect(self, origins: FloatArray, directions: FloatArray, t_min: FloatArray) -> FloatArray:
        ox, oy, oz = origins.T
        dx, dy, dz = directions.T
        radius = self.r0 + self.slope * oz
        grow = self.slope * dz
        a = dx * dx + dy * dy - grow * grow
        b = ox * dx + oy * dy - radius * grow
        c = ox * ox + oy * oy - radius * radius
        low, high = slab(oz, dz, 0.0, self.height)
        near, far = _quadratic(np.where(a > _TINY, a, 1.0), b, c)
        # a < 0: the ray is steeper than the mantle, which cuts one end only; the other root is on the mirrored cone
        steep = a < -_TINY
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        safe = np.where(steep, a, -1.0)
        near = np.where(steep, np.where(grow > 0, (-b - root) / safe, -np.inf), near)
        far = np.where(steep, np.where(grow > 0, np.inf, (-b + root) / safe), far)
        # a = 0: along the mantle, b = 0 too: along the axis of a cylinder
        along = np.abs(a) <= _TINY
        linear = np.abs(b) > _TINY
        end = -c / (2 * np.where(linear, b, 1.0))
        near = np.where(along, np.where(linear, np.where(b < 0, end, -np.inf), np.where(c <= 0, -np.inf, np.inf)), near)
        far = np.where(along, np.where(linear & (b > 0), end, np.inf), far)
        return first_inside(np.maximum(near, low), np.minimum(far, high), t_min)

    def normals(self, points: FloatArray) -> FloatArray:
        x, y, z = points.T
        radius = np.hypot(x, y)
        mantle = np.abs(radius - (self.r0 + self.slope * z)) / np.hypot(1.0, self.slope)
        bottom, top = np.abs(z), np.abs(z - self.height)
        side = _unit(np.stack([x, y, -self.slope * radius], -1))
        cap = np.zeros_like(points)
        cap[:, 2] = np.where(top < bottom, 1.0, -1.0)
        return np.where((mantle <= np.minimum(bottom, top))[:, None], side, cap)


class Ellipsoid(Solid):
    """An ellipsoid about the origin with semi-axes ``radii`` (3,)."""

    def __init__(self, radii: Sequence[float]) -> None:
        self.radii = np.asarray(radii, np.float64)
        self.low, self.high = -self.radii, self.radii

    def intersect(self, origins: FloatArray, directions: FloatArray, t_min: FloatArray) -> FloatArray:
        o, d = origins / self.radii, directions / self.radii
        near, far = _quadratic((d * d).sum(-1), (o * d).sum(-1), (o * o).sum(-1) - 1.0)
        return first_inside(near, far, t_min)

    def normals(self, points: FloatArray) -> FloatArray:
        return _unit(points / self.radii**2)


class Spheres(Solid):
    """A union of spheres, such as a tree's crown: centres (M, 3), radii (M,)."""

    def __init__(self, centers: FloatArray, radii: FloatArray) -> None:
        self.centers, self.radii = np.asarray(centers, np.float64), np.asarray(radii, np.float64)
        self.low = (self.centers - self.radii[:, None]).min(0)
        self.high = (self.centers + self.radii[:, None]).max(0)

    def intersect(self, origins: FloatArray, directions: FloatArray, t_min: FloatArray) -> FloatArray:
        best = np.full(len(origins), np.inf)
        # the spheres' common terms once: |o - c|^2 - r^2 = |o|^2 - 2 o.c + |c|^2 - r^2
        middle = (self.low + self.high) / 2
        o, centers = origins - middle, self.centers - middle
        od, oo = (o * directions).sum(-1), (o * o).sum(-1)
        rest = (centers * centers).sum(-1) - self.radii**2
        for start in range(0, len(o), 16384):
            part = slice(start, start + 16384)
            b = od[part, None] - directions[part] @ centers.T
            c = oo[part, None] - 2 * (o[part] @ centers.T) + rest
            discriminant = b * b - c
            rays, spheres = np.nonzero(discriminant >= 0)
            root = np.sqrt(discriminant[rays, spheres])
            middle_t = -b[rays, spheres]
            t = first_inside(middle_t - root, middle_t + root, t_min[part][rays])
            np.minimum.at(best, start + rays, t)
        return best

    def normals(self, points: FloatArray) -> FloatArray:
        out = np.empty_like(points)
        for start in range(0, len(points), 16384):
            p = points[start : start + 16384]
            offset = p[:, None] - self.centers
            nearest = np.abs(np.linalg.norm(offset, axis=-1) - self.radii).argmin(1)
            out[start : start + 16384] = offset[np.arange(len(p)), nearest] / self.radii[nearest, None]
        return out

    def soft_normals(self, points: FloatArray) -> FloatArray:
        """Mostly the crown's own roundness: a crown is lit as a whole, its clumps only ruffle it."""
        return _unit(0.45 * self.normals(points) + 0.75 * _unit(points - (self.low + self.high) / 2))


_RAY_START_OFFSET_M = 1e-3
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
        hits = self._mesh.first_hits(points - _RAY_START_OFFSET_M * directions, directions, 0.0)
        u, v = hits.uv[:, :1].astype(np.float64), hits.uv[:, 1:].astype(np.float64)
        hit = hits.face >= 0
        face = np.where(hit, hits.face, 0)
        soft = self.soft[face].astype(np.float64)
        soft = soft[:, 0] * (1 - u - v) + soft[:, 1] * u + soft[:, 2] * v
        soft /= np.maximum(np.linalg.norm(soft, axis=1, keepdims=True), 1e-9)
        own = self.face_normals[face].astype(np.float64)
        # a ray along an edge may miss it on its second way: it is taken as hit head-on
        own, soft = (np.where(hit[:, None], n, -directions) for n in (own, soft))
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
