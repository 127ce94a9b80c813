"""Distances between entities of OpenSCENARIO, and to places: along and across a path, and between boxes."""

from __future__ import annotations

import math

import numpy as np

from ...geometry import FloatArray
from .entities import Entity
from .paths import Place


def distance_between(
    entity: Entity, other: Entity | Place, kind: str, free: bool, system: str, time_s: float
) -> float | None:
    """Return the distance from an entity to another one, or to a place: along or across it, positive ahead and to the left,
    or the shortest one. ``free``: between their boxes. ``system``: along its box ("entity"), along the line that its path
    has there ("ahead"), or along its path. None where one is not there."""
    own = entity.place(time_s)
    there = other.place(time_s) if isinstance(other, Entity) else other
    if own is None or there is None or (isinstance(other, Entity) and not other.is_there):
        return None
    box = _outline(entity, own)
    outline = _outline(other, there) if isinstance(other, Entity) else np.array([there[:2]] * 4)
    if kind not in ("longitudinal", "lateral"):
        if not free:
            return math.dist(own[:2], there[:2])
        if isinstance(other, Entity):
            return boxes_apart(box, outline)
        return boxes_apart(box, outline + np.array([[0, 0], [1e-6, 0], [1e-6, 1e-6], [0, 1e-6]]))
    axis, ahead = own[3], None
    if system != "entity":
        path = entity.on_path(time_s)
        if path is not None:
            curve, s, left = path
            s_other, left_other = curve.project(there[0], there[1])
            axis = curve.at(s)[3]
            if system != "ahead":
                ahead = np.array([s_other - s, left_other - left])
    cos, sin = math.cos(axis), math.sin(axis)
    turn = np.array([[cos, -sin], [sin, cos]])
    if ahead is None:
        ahead = (np.array(there[:2]) - np.array(own[:2])) @ turn
    way = 0 if kind == "longitudinal" else 1
    gap = float(ahead[way])
    if not free:
        return gap
    mine = ((box - np.array(own[:2])) @ turn)[:, way]
    # the other box is turned as it is to this one, beside its own reference point
    its = ((outline - np.array(there[:2])) @ turn)[:, way] + gap
    if its.min() > mine.max():
        return float(its.min() - mine.max())
    return float(its.max() - mine.min()) if its.max() < mine.min() else 0.0


def _outline(entity: Entity, place: Place) -> FloatArray:
    """Return the corners (4, 2) of an entity's box in the plane."""
    x, y, _, h, _, _ = place
    length, width, _ = entity.size_m
    cos, sin = math.cos(h), math.sin(h)
    turn = np.array([[cos, sin], [-sin, cos]])
    cx, cy, _ = entity.centre
    corners = np.array([[length, width], [-length, width], [-length, -width], [length, -width]]) / 2 + np.array(
        [cx, cy]
    )
    return np.array([x, y]) + corners @ turn


def boxes_apart(a: FloatArray, b: FloatArray) -> float:
    """Return how far two convex outlines (N, 2), (M, 2) are apart in the plane; 0 where they overlap."""
    for first, second in ((a, b), (b, a)):
        for edge in np.roll(first, -1, 0) - first:
            across = np.array([-edge[1], edge[0]])
            low, high = first @ across, second @ across
            if low.max() < high.min() or high.max() < low.min():
                return min(_outside(a, b), _outside(b, a))
    return 0.0


def _outside(points: FloatArray, outline: FloatArray) -> float:
    """Return the least distance of points from an outline's edges."""
    starts, edges = outline, np.roll(outline, -1, 0) - outline
    to = points[:, None] - starts[None]
    lengths = np.maximum((edges**2).sum(1), 1e-12)
    share = np.clip((to * edges).sum(2) / lengths, 0, 1)
    return float(np.linalg.norm(to - share[..., None] * edges, axis=2).min())
