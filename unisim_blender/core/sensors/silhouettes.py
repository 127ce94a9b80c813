"""Image areas of boxes and spheres seen through a lens that bends lines: corners do not bound a silhouette there."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..geometry import UNIT_BOX_CORNERS, BoolArray, FloatArray, invert_pose, transform_points
from ..world.drive import CameraModel

POINTS_PER_EDGE = 33
"""Number of points by which an edge of a box is projected."""
MIN_DEPTH_M = 0.01
"""Smallest depth of what a pinhole shows, metres."""
DOMAIN_DIRECTIONS = 180
"""Number of directions at the edge of the valid domain that are intersected with a box."""
BOX_EDGES = np.array([(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit])
"""Pairs (12, 2) of the corners of a box that edges connect, as `box_corners` numbers them: a bit for each axis."""
PIECES = 24
"""Number of pieces of an edge that is drawn."""


class Silhouette(NamedTuple):
    """A rectangle, in pixels, around what a box covers of the image plane; it may extend beyond the image."""

    left: float
    top: float
    right: float
    bottom: float


def box_silhouette(model: CameraModel, camera_from_box: FloatArray, size_m: FloatArray) -> Silhouette | None:
    """Return a rectangle that holds all pixels whose rays hit a box of edges ``size_m`` (3,) at ``camera_from_box`` (4,
    4); None where none does. Never too small.

    The edge of what a box covers consists of projected edges of the box and, where it is cut, of the valid domain's
    edge.
    """
    size = np.asarray(size_m, float)
    corners = UNIT_BOX_CORNERS * size
    part = np.linspace(0, 1, POINTS_PER_EDGE)[:, None]
    edges = np.stack([corners[a] + part * (corners[b] - corners[a]) for a, b in BOX_EDGES])
    u, v, valid = model.project(transform_points(camera_from_box, edges.reshape(-1, 3)).reshape(edges.shape))
    points, gap = [], 0.0
    if valid.any():
        points.append(np.stack([u[valid], v[valid]], -1))
        gap = _gap(u, v)
    if not valid.all():
        # the box reaches beyond the domain: which of the domain's edge does it hold, and does it hold the domain
        round_u, round_v, hit, axis_hit = _domain_edge(model, camera_from_box, size)
        if not valid.any() and axis_hit:
            return Silhouette(0.0, 0.0, float(model.width), float(model.height))
        inside = hit | np.roll(hit, 1) | np.roll(hit, -1)
        if inside.any():
            points.append(np.stack([round_u[inside], round_v[inside]], -1))
            gap = max(gap, _gap(round_u[None], round_v[None]))
        elif valid.any():
            gap *= 2
    if not points:
        return None
    every = np.concatenate(points)
    low, high = every.min(0) - gap / 2, every.max(0) + gap / 2
    return Silhouette(float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def covered(model: CameraModel, camera_from_box: FloatArray, size_m: FloatArray) -> Silhouette | None:
    """Return a rectangle that holds all pixels whose rays hit a box of edges ``size_m`` (3,) in one of its poses
    ``camera_from_box`` (K, 4, 4); None where none does. Never too small; through a pinhole, tight."""
    if not model.is_pinhole:
        parts = [box_silhouette(model, pose, size_m) for pose in camera_from_box]
        rectangles = [part for part in parts if part is not None]
        if not rectangles:
            return None
        low, high = np.min([part[:2] for part in rectangles], 0), np.max([part[2:] for part in rectangles], 0)
        return Silhouette(*low.tolist(), *high.tolist())
    corners = transform_points(camera_from_box, UNIT_BOX_CORNERS * np.asarray(size_m, float))
    first, second = (corners[:, ends] for ends in BOX_EDGES.T)
    # where edges pass the plane that nothing is nearer than
    passing = (first[..., 2] > MIN_DEPTH_M) != (second[..., 2] > MIN_DEPTH_M)
    a, b = first[passing], second[passing]
    at = (MIN_DEPTH_M - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    ahead = np.concatenate([corners[corners[..., 2] > MIN_DEPTH_M], a + at * (b - a)])
    if not len(ahead):
        return None
    depth = np.maximum(ahead[:, 2], MIN_DEPTH_M)
    u, v = model.fx * ahead[:, 0] / depth + model.cx, model.fy * ahead[:, 1] / depth + model.cy
    return Silhouette(float(u.min()), float(v.min()), float(u.max()), float(v.max()))


def box_bounds(model: CameraModel, camera_from_box: FloatArray, size_m: FloatArray) -> Silhouette | None:
    """Return the rectangle around the projected edges of a box of edges ``size_m`` (3,) at ``camera_from_box`` (4, 4);
    None where it projects nowhere. Tight where the whole box lies in the lens's valid domain, else that of
    `box_silhouette`."""
    corners = UNIT_BOX_CORNERS * np.asarray(size_m, float)
    part = np.linspace(0, 1, POINTS_PER_EDGE)[:, None]
    edges = np.concatenate([corners[a] + part * (corners[b] - corners[a]) for a, b in BOX_EDGES])
    u, v, valid = model.project(transform_points(camera_from_box, edges))
    if not valid.all():
        return box_silhouette(model, camera_from_box, size_m)
    return Silhouette(float(u.min()), float(v.min()), float(u.max()), float(v.max()))


def _gap(u: FloatArray, v: FloatArray) -> float:
    """Return the largest distance between neighbours on lines (L, N): a line deviates from its points by at most half
    of it."""
    apart = np.hypot(np.diff(u, axis=-1), np.diff(v, axis=-1))
    return float(apart[np.isfinite(apart)].max(initial=0.0))


def _domain_edge(
    model: CameraModel, camera_from_box: FloatArray, size: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray, bool]:
    """Return points u, v (N,) of the valid domain's edge, whether (N,) the box lies behind them, and whether it lies on
    the optical axis."""
    angle = min(model.lens.max_angle_rad, math.radians(89.9) if model.is_pinhole else math.pi) * (1 - 1e-9)
    heading = np.linspace(0, 2 * np.pi, DOMAIN_DIRECTIONS, endpoint=False)
    sine = math.sin(angle)
    rays = np.stack([sine * np.cos(heading), sine * np.sin(heading), np.full(DOMAIN_DIRECTIONS, math.cos(angle))], -1)
    u, v, _ = model.project(rays)
    box_from_camera = invert_pose(camera_from_box)
    local = np.concatenate([rays, [[0.0, 0.0, 1.0]]]) @ box_from_camera[:3, :3].T
    safe = np.where(np.abs(local) < 1e-12, 1e-12, local)
    a, b = (-size / 2 - box_from_camera[:3, 3]) / safe, (size / 2 - box_from_camera[:3, 3]) / safe
    enter, leave = np.minimum(a, b).max(1), np.maximum(a, b).min(1)
    hit = (enter <= leave) & (leave > 0)
    return u, v, hit[:-1], bool(hit[-1])


@lru_cache(maxsize=64)
def view_half_angle(model: CameraModel, pad_px: float) -> float:
    """Return the half angle, radians, of a cone around the optical axis that holds all rays of an image with ``pad_px``
    pixels more on every side: the angle from the axis is largest on the image's border or at the valid domain's
    edge."""
    across, down = np.linspace(-pad_px, model.width + pad_px, 257), np.linspace(-pad_px, model.height + pad_px, 257)
    ends_u, ends_v = (across[0], across[-1]), (down[0], down[-1])
    u = np.concatenate([across, across, np.full(257, ends_u[0]), np.full(257, ends_u[1])])
    v = np.concatenate([np.full(257, ends_v[0]), np.full(257, ends_v[1]), down, down])
    rays = model.unproject(u, v)
    if not np.isfinite(rays).all():
        return min(model.lens.max_angle_rad, math.pi)
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    # between two points of the border the angle is larger by less than they are apart
    apart = np.arccos(np.clip((rays[1:] * rays[:-1]).sum(1), -1, 1))
    apart[256::257] = 0.0
    return min(float(angle.max() + apart.max() / 2), math.pi)


def spheres_in_cone(centres: FloatArray, radii: FloatArray, half_angle: float) -> BoolArray:
    """Return which spheres of radii (...), centres (..., 3) in the camera's frame, touch a cone of ``half_angle``,
    radians, around the optical axis, which may be wider than a half space: (...) bool."""
    distance = np.linalg.norm(centres, axis=-1)
    angle = np.arctan2(np.hypot(centres[..., 0], centres[..., 1]), centres[..., 2])
    reach = np.arcsin(np.clip(radii / np.maximum(distance, 1e-12), 0, 1))
    return np.asarray((distance <= radii) | (angle <= half_angle + reach))


def bent_edges(model: CameraModel, camera_from_box: FloatArray, box: FloatArray) -> FloatArray:
    """Return the edges of a box with corners ``box`` (8, 3) as segments (S, 2, 2) of an image in pixels;
    ``camera_from_box`` (4, 4) leads to the camera's axes, OpenCV's. What lies outside the lens's valid domain or ends
    outside the image is left out."""
    part = np.linspace(0.0, 1.0, PIECES + 1)[None, :, None]
    ends = transform_points(camera_from_box, box)[BOX_EDGES]
    points = ends[:, None, 0] * (1 - part) + ends[:, None, 1] * part
    u, v, valid = model.project(points)
    seen = valid & (u >= 0) & (u <= model.width) & (v >= 0) & (v <= model.height)
    pixels = np.stack([u, v], -1)
    return np.asarray(np.stack([pixels[:, :-1], pixels[:, 1:]], 2)[seen[:, :-1] & seen[:, 1:]])
