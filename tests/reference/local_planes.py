"""Local planes of a point cloud, every place against every point: what `Neighbours.planes` computes in the
compiled kernels."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.render.tracers.surfels.build import FittedPlanes


def local_planes_reference(points: FloatArray, places: FloatArray, radius_m: float, most: int) -> FittedPlanes:
    """`Neighbours.planes`, every place against every point; float64, by numpy's eigenvectors."""
    count, reach = np.zeros(len(places), np.int32), np.zeros(len(places), np.float32)
    normal, (height, rough) = np.zeros((len(places), 3), np.float32), np.zeros((2, len(places)), np.float32)
    for i, place in enumerate(places):
        distance = np.linalg.norm(points - place, axis=1)
        near = np.argsort(distance, kind="stable")[:most]
        near = near[distance[near] <= radius_m]
        count[i], reach[i] = len(near), distance[near].max(initial=0.0)
        if len(near) < 3:
            continue
        offset = points[near] - points[near].mean(0)
        normal[i] = np.linalg.eigh(offset.T @ offset)[1][:, 0]
        height[i] = normal[i] @ (points[near].mean(0) - place)
        rough[i] = np.std(offset @ normal[i])
    return FittedPlanes(count, normal, height, rough, reach)
