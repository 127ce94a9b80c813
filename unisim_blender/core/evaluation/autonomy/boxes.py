"""Intersection over union of boxes seen from above, turned by any angle, and of upright boxes in an image."""

from __future__ import annotations

import numpy as np

from ...geometry import FloatArray


def bev_corners(boxes: FloatArray) -> FloatArray:
    """Corners (N, 4, 2), counter-clockwise from the front left, of boxes (N, 5): x, y, length, width, yaw (m, rad)."""
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2
    local = signs * boxes[:, None, 2:4]
    cosine, sine = np.cos(boxes[:, 4]), np.sin(boxes[:, 4])
    rotation = np.stack([np.stack([cosine, sine], -1), np.stack([-sine, cosine], -1)], 1)
    return np.asarray(local @ rotation + boxes[:, None, :2])


def bev_iou(a: FloatArray, b: FloatArray) -> FloatArray:
    """IoU (N, M) of boxes (N, 5) and (M, 5): x, y, length, width, yaw."""
    reach = (np.hypot(a[:, 2], a[:, 3])[:, None] + np.hypot(b[:, 2], b[:, 3])) / 2
    rows, columns = np.nonzero(np.hypot(a[:, None, 0] - b[:, 0], a[:, None, 1] - b[:, 1]) < reach)
    first, second = a[rows].copy(), b[columns].copy()
    second[:, :2] -= first[:, :2]  # near the origin nothing is lost to large coordinates
    first[:, :2] = 0.0
    shared = convex_intersection_area(bev_corners(first), bev_corners(second))
    out = np.zeros((len(a), len(b)))
    out[rows, columns] = shared / (a[rows, 2] * a[rows, 3] + b[columns, 2] * b[columns, 3] - shared)
    return out


def convex_intersection_area(polygons: FloatArray, clips: FloatArray) -> FloatArray:
    """Area (P,) that convex polygons (P, K, 2) share with convex ``clips`` (P, E, 2), both counter-clockwise.

    Sutherland and Hodgman, "Reentrant polygon clipping" (1974), all pairs at once.
    """
    for edge in range(clips.shape[1]):
        start = clips[:, edge]
        polygons = _cut(polygons, start, clips[:, (edge + 1) % clips.shape[1]] - start)
    x, y = polygons[..., 0], polygons[..., 1]
    return np.asarray(np.abs((x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y).sum(1)) / 2)


def _cut(polygons: FloatArray, start: FloatArray, along: FloatArray) -> FloatArray:
    """Clip polygons (P, K, 2) to the left of lines, each a point (P, 2) and a direction (P, 2). Return (P, K + 1, 2),
    the last vertex repeated."""
    pairs, vertices = polygons.shape[:2]
    offset = polygons - start[:, None]
    side = along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]
    ahead, side_ahead = np.roll(polygons, -1, 1), np.roll(side, -1, 1)
    inside = side >= 0
    crosses = inside != (side_ahead >= 0)
    t = side / np.where(crosses, side - side_ahead, 1.0)
    points = np.stack([polygons, polygons + t[..., None] * (ahead - polygons)], 2).reshape(pairs, 2 * vertices, 2)
    kept = np.stack([inside, crosses], 2).reshape(pairs, 2 * vertices)
    order = np.argsort(~kept, 1, kind="stable")[:, : vertices + 1]
    last = np.maximum(kept.sum(1) - 1, 0)
    order = np.take_along_axis(order, np.minimum(np.arange(order.shape[1]), last[:, None]), 1)
    out = np.take_along_axis(points, order[..., None], 1)
    out[~kept.any(1)] = 0.0
    return out


def image_iou(a: FloatArray, b: FloatArray) -> FloatArray:
    """IoU (N, M) of boxes (N, 4) and (M, 4): left, top, right, bottom."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), -1)
    area_a, area_b = np.prod(a[:, 2:] - a[:, :2], -1), np.prod(b[:, 2:] - b[:, :2], -1)
    return np.asarray(shared / (area_a[:, None] + area_b - shared))


def without_duplicates(iou: FloatArray, scores: FloatArray, most: float) -> list[int]:
    """Boxes that stay, best first, when each takes away those of lower score that overlap it by more than ``most``.

    iou (N, N), scores (N,). Greedy non-maximum suppression; of equal scores the first stays.
    """
    kept: list[int] = []
    left = np.ones(len(scores), bool)
    for index in np.argsort(-scores, kind="stable"):
        if left[index]:
            kept.append(int(index))
            left &= iou[index] <= most
    return kept
