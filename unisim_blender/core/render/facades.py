"""Façades of a street: large vertical planes, walls, hedges and fences, fitted to what recorded images and sweeps show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray
from ..sensors.rays import Rays
from .confidence import DepthView
from .plane_fill import REACH_M

CELL_M = 0.25
"""Edge, metres, of the cells of a plan in which vertical surfaces are counted, and of their parts one above the other."""
MOST_UPRIGHT = 0.25
"""Largest vertical component of the normal of a vertical surface."""
LEAST_RISE_M, LEAST_LENGTH_M, LEAST_AREA_M2 = 0.75, 4.0, 6.0
"""Least height of the vertical surfaces of a cell, and length and area of a plane."""
THICK_M, GAP_M, FOOT_M = 0.25, 8.0, 0.5
"""Largest distance of a plane's cells from it, and between two of them along it, and how far it goes on below them, metres."""
STEEP = 0.15
"""Largest difference of distances of three pixels side by side on one surface, as a part of them."""
TRIALS, MAX_PLANES = 400, 16
"""Number of pairs of cells of which the best is fitted, and largest number of planes."""


def fitted_facades(surfaces: Sequence[tuple[FloatArray, FloatArray]]) -> list[tuple[FloatArray, FloatArray]]:
    """Return the vertical planes of surfaces, points (N, 3) and unit normals (N, 3) each, world frame, by random sample consensus
    of cells of a plan (Fischler & Bolles, CACM 1981): the poses of their grids, grid_from_world, with x along the plane, y up
    and z off it, and their lengths and heights (2,) in metres."""
    points, normals = (np.concatenate([each[part] for each in surfaces]) for part in (0, 1))
    upright = np.abs(normals[:, 2]) < MOST_UPRIGHT
    points, normals = points[upright], normals[upright]
    _, number = np.unique(np.floor(points / CELL_M).astype(np.int64), axis=0, return_inverse=True)
    boxes = _means(np.concatenate([points, normals], 1), number)
    _, number, count = np.unique(
        np.floor(boxes[:, :2] / CELL_M).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    cells = _means(boxes, number)
    low, high = np.full(len(count), np.inf), np.full(len(count), -np.inf)
    np.minimum.at(low, number, boxes[:, 2])
    np.maximum.at(high, number, boxes[:, 2])
    there = count * CELL_M >= LEAST_RISE_M
    places, facing, area = cells[there, :2], cells[there, 3:5], count[there] * CELL_M**2
    low, high = low[there], high[there]
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-6)
    rng, out = np.random.default_rng(0), []
    for _ in range(MAX_PLANES):
        if len(places) < 3:
            break
        pairs = rng.integers(0, len(places), (TRIALS, 2))
        best = max((_on_line(places, facing, places[a], places[b]) for a, b in pairs), key=lambda on: area[on].sum())
        for _ in range(2 if best.sum() > 2 else 0):
            middle, along = _line(places[best], area[best])
            best = _on_line(places, facing, middle, middle + along)
        if best.sum() < 3 or area[best].sum() < LEAST_AREA_M2:
            break
        middle, along = _line(places[best], area[best])
        run = _longest_run((places[best] - middle) @ along, area[best])
        some = np.flatnonzero(best)[run]
        beside = (places[some] - middle) @ along
        length, bottom = float(np.ptp(beside)), float(low[some].min()) - FOOT_M
        if area[some].sum() >= LEAST_AREA_M2 and length >= LEAST_LENGTH_M:
            x, y = along
            start = middle + along * beside.min()
            grid_from_world = np.eye(4)
            grid_from_world[:3, :3] = [[x, y, 0], [0, 0, 1], [y, -x, 0]]
            grid_from_world[:3, 3] = -grid_from_world[:3, :3] @ [*start, bottom]
            out.append((grid_from_world, np.array([length, float(np.quantile(high[some], 0.9)) - bottom])))
        left = np.ones(len(places), bool)
        left[some] = False
        places, facing, area, low, high = (x[left] for x in (places, facing, area, low, high))
    return out


def _means(values: FloatArray, number: NDArray[np.int64]) -> FloatArray:
    """Return the means (M, C) of those values (N, C) that have the same number (N,)."""
    total = np.stack([np.bincount(number, column) for column in values.T], 1)
    return np.asarray(total / np.bincount(number)[:, None])


def _on_line(places: FloatArray, facing: FloatArray, a: FloatArray, b: FloatArray) -> BoolArray:
    """Return which cells (N,) lie on the line of two places, and face away from it."""
    length = float(np.linalg.norm(b - a))
    if length < 1e-6:
        return np.zeros(len(places), bool)
    normal = np.array([b[1] - a[1], a[0] - b[0]]) / length
    return np.asarray((np.abs((places - a) @ normal) < THICK_M) & (np.abs(facing @ normal) > 0.9))


def _line(places: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the middle (2,) and the direction (2,) of places (N, 2)."""
    middle = np.average(places, axis=0, weights=weight)
    _, axes = np.linalg.eigh(np.cov(places.T, aweights=weight))
    return middle, axes[:, 1]


def _longest_run(beside: FloatArray, area: FloatArray) -> NDArray[np.int64]:
    """Return the numbers of those places along a line (N,) that have no gap between them and the largest area."""
    order = np.argsort(beside)
    parts = np.split(order, np.flatnonzero(np.diff(beside[order]) > GAP_M) + 1)
    return max(parts, key=lambda part: float(area[part].sum()))


def surfaces_of(view: DepthView, rays: Rays) -> tuple[FloatArray, FloatArray]:
    """Return points (N, 3) on static surfaces that a recorded view shows along its rays (h, w), and their normals (N, 3)."""
    depth = (view.nearest.astype(np.float64) + view.farthest) / 2
    points = rays.origins + rays.directions * depth[..., None]
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    normals = np.cross(across, down)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    normals *= -np.sign((normals * rays.directions[1:-1, 1:-1]).sum(-1, keepdims=True))
    inner = (slice(1, -1), slice(1, -1))
    near, far = view.nearest[inner], view.farthest[inner]
    shown = (near > 0) & (far < REACH_M) & (far - near < STEEP * near) & (view.actor[inner] == 0)
    return points[inner][shown], normals[shown]
