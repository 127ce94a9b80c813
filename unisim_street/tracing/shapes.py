"""Shapes that rays hit, vectorised over rays; here solids with closed-form intersections.

Each shape stands in its own frame. ``intersect`` gives, for rays (N, 3) with unit directions, the smallest t >= t_min
at which the ray is inside the solid or on its surface: t_min itself where it starts inside, inf where it never enters.
``normals`` gives the outward unit normals of surface points. `triangles.TracedTriangles` are surfaces: they have no inside.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from unisim_blender.core.geometry import FloatArray

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
    """What a ray can hit."""

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
