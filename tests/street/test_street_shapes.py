"""The street's closed-form intersections, beside dense sampling of each solid and triangles of the same hull."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from unisim_blender.core.geometry import BoolArray, FloatArray
from unisim_street.assets.cars import STYLES, car
from unisim_street.assets.facade import Facade, Storey
from unisim_street.tracing.shapes import Cone, Convex, Ellipsoid, Solid, Spheres, box, hull

Inside = Callable[[FloatArray], BoolArray]

CENTERS = np.array([[0.0, 0.0, 0.0], [0.5, 0.2, 0.1], [-0.2, 0.6, 0.4]])
RADII = np.array([0.5, 0.3, 0.35])
STOREYS = (Storey(0.0, 0.2, 1.0, 0.3, 1.0, 0.6, 2, 0.3), Storey(1.2, 1.4, 2.0, 0.2, 0.8, 0.4, 3, 0.15))
FRONT = Facade(2.6, 1.5, 2.3, STOREYS)


def in_facade(p: FloatArray) -> BoolArray:
    inside = ((p >= 0) & (p <= [2.6, 1.5, 2.3])).all(-1)
    for storey in STOREYS:
        for column in range(storey.count):
            left = storey.first + column * storey.pitch
            low, high = np.array([left, -1.0, storey.low]), np.array([left + storey.width, storey.depth, storey.high])
            inside &= ~((p > low) & (p < high)).all(-1)
    return np.asarray(inside)


def in_cone(r0: float, r1: float) -> Inside:
    return lambda p: (
        (p[..., 2] >= 0) & (p[..., 2] <= 1) & (np.hypot(p[..., 0], p[..., 1]) <= r0 + (r1 - r0) * p[..., 2])
    )


BLOCK = hull(np.array([[0, 0, 0], [1, 0, 0], [0, 1.2, 0], [0.2, 0.3, 0.9], [0.8, 0.7, 0.5]]))
SOLIDS: dict[str, tuple[Solid, Inside]] = {
    "box": (
        box((-0.5, -0.2, 0.1), (0.6, 0.9, 0.7)),
        lambda p: ((p >= [-0.5, -0.2, 0.1]) & (p <= [0.6, 0.9, 0.7])).all(-1),
    ),
    "hull": (BLOCK, lambda p: (p @ BLOCK.planes.T <= BLOCK.offsets).all(-1)),
    "cylinder": (Cone(0.5, 0.5, 1.0), in_cone(0.5, 0.5)),
    "cone": (Cone(0.6, 0.1, 1.0), in_cone(0.6, 0.1)),
    "funnel": (Cone(0.0, 0.7, 1.0), in_cone(0.0, 0.7)),
    "ellipsoid": (Ellipsoid((0.8, 0.4, 0.6)), lambda p: (p**2 / np.array([0.8, 0.4, 0.6]) ** 2).sum(-1) <= 1),
    "spheres": (Spheres(CENTERS, RADII), lambda p: (((p[..., None, :] - CENTERS) ** 2).sum(-1) <= RADII**2).any(-1)),
    "facade": (FRONT, in_facade),
}


def rays_at(shape: Solid, count: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Rays from a shell round the shape to points in its box, some of them along an axis."""
    rng = np.random.default_rng(seed)
    target = rng.uniform(shape.low, shape.high, (count, 3))
    reach = 2.0 * float(np.linalg.norm(shape.high - shape.low))
    origin = (shape.low + shape.high) / 2 + reach * trimesh.unitize(rng.standard_normal((count, 3)))
    axes = np.eye(3)[rng.integers(3, size=count // 4)] * rng.choice([-1.0, 1.0], (count // 4, 1))
    origin[: count // 4] = target[: count // 4] - reach * axes
    return origin, trimesh.unitize(target - origin)


@pytest.mark.parametrize("name", SOLIDS)
def test_first_hit_beside_dense_samples(name: str) -> None:
    shape, inside = SOLIDS[name]
    origins, directions = rays_at(shape, 400)
    t = shape.intersect(origins, directions, np.zeros(len(origins)))
    steps = np.arange(0.0, 12.0, 3e-3)
    sampled = inside(origins[:, None] + steps[:, None] * directions[:, None])
    before = sampled & (steps < t[:, None] - 1e-6)
    assert not before.any()
    hit = np.isfinite(t)
    assert hit.sum() > 200
    assert inside(origins[hit] + (t[hit, None] + 1e-7) * directions[hit]).mean() > 0.99  # edges can be left within 1e-7
    assert not inside(origins[hit] + (t[hit, None] - 1e-6) * directions[hit]).any()


@pytest.mark.parametrize("name", SOLIDS)
def test_normals_point_out(name: str) -> None:
    shape, inside = SOLIDS[name]
    origins, directions = rays_at(shape, 400, seed=1)
    t = shape.intersect(origins, directions, np.zeros(len(origins)))
    hit = np.isfinite(t)
    points = origins[hit] + t[hit, None] * directions[hit]
    normals = shape.normals(points)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
    assert (np.einsum("ij,ij->i", normals, directions[hit]) < 1e-9).all()
    assert not inside(points + 1e-6 * normals).any()
    assert inside(points - 1e-6 * normals).mean() > 0.99


@pytest.mark.parametrize("name", SOLIDS)
def test_a_ray_that_starts_inside_hits_where_it_starts(name: str) -> None:
    shape, inside = SOLIDS[name]
    origins, directions = rays_at(shape, 200, seed=2)
    t = shape.intersect(origins, directions, np.zeros(len(origins)))
    deeper = t + 0.01
    within = np.isfinite(t) & inside(origins + np.where(np.isfinite(t), deeper, 0.0)[:, None] * directions)
    assert within.sum() > 50
    np.testing.assert_array_equal(shape.intersect(origins, directions, deeper)[within], deeper[within])


def test_car_body_beside_its_triangles() -> None:
    body = car("car", STYLES["sedan"], "#808080").parts[0].shape
    assert isinstance(body, Convex)
    corners = trimesh.convex.convex_hull(_vertices(body))
    origins, directions = rays_at(body, 300, seed=3)
    expected = _triangle_hits(corners.triangles, origins, directions)
    found = body.intersect(origins, directions, np.zeros(len(origins)))
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
    hit = np.isfinite(found)
    assert hit.sum() > 100
    np.testing.assert_allclose(found[hit], expected[hit], atol=1e-6)


def test_cars_stand_on_the_ground_within_their_boxes() -> None:
    for name, style in STYLES.items():
        asset = car(name, style, "#808080")
        low, high = asset.corners.min((0, 1)), asset.corners.max((0, 1))
        assert (low >= -style.size_m / 2 - 1e-9).all() and (high <= style.size_m / 2 + 1e-9).all(), name
        assert low[2] == pytest.approx(-style.size_m[2] / 2), name


def _vertices(body: Convex) -> FloatArray:
    """Corners of a convex body from its planes: where three of them meet and no other cuts."""
    n = len(body.planes)
    triples = np.array([(a, b, c) for a in range(n) for b in range(a) for c in range(b)])
    normals, offsets = body.planes[triples], body.offsets[triples]
    solvable = np.abs(np.linalg.det(normals)) > 1e-6
    points = np.linalg.solve(normals[solvable], offsets[solvable][..., None])[..., 0]
    return np.asarray(points[(points @ body.planes.T <= body.offsets + 1e-6).all(1)])


def _triangle_hits(triangles: FloatArray, origins: FloatArray, directions: FloatArray) -> FloatArray:
    """First hits by Moeller and Trumbore's test of every triangle."""
    a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(directions[:, None], ac)
    determinant = (p * ab).sum(-1)
    s = origins[:, None] - a
    q = np.cross(s, ab)
    parallel = np.abs(determinant) < 1e-12
    determinant = np.where(parallel, 1.0, determinant)
    u, v, t = (
        (p * s).sum(-1) / determinant,
        (q * directions[:, None]).sum(-1) / determinant,
        (q * ac).sum(-1) / determinant,
    )
    hit = ~parallel & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 0)
    return np.asarray(np.where(hit, t, np.inf).min(1))
