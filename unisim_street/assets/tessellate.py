"""The exact street's solids as triangles."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import FloatArray

from ..tracing.shapes import Cone, Convex, Ellipsoid, TracedShape
from ..tracing.triangles import TracedTriangles, grid, quads
from .facade import Facade

_ROUND = 28
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


def revolved(profile: FloatArray, sides: int = _ROUND) -> TracedTriangles:
    """What a profile (P, 2) of radii and heights sweeps about z, its outside to the profile's right; edges
    of it stay sharp."""
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
