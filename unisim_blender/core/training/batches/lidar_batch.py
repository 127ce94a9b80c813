"""Random LiDAR rays as a step takes them, and which returns are of the static scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...geometry import BoolArray, FloatArray, invert_pose, transform_points
from ...ops.ray_segments import RayBatch
from ...world.drive import Actor


@dataclass(frozen=True)
class LidarBatch:
    """LiDAR rays with what they measured: depth_m, intensity (N,), returned (N,) bool; weight (N,) makes drops, of
    which more are drawn than there are, count as often as they occur."""

    rays: RayBatch
    depth_m: Tensor
    intensity: Tensor
    returned: Tensor
    weight: Tensor


def ray_batch(
    origins: NDArray[np.floating[Any]], directions: NDArray[np.floating[Any]], time_s: FloatArray
) -> RayBatch:
    """Rays as tensors, origins (N, 3) from the volume's corner."""
    return RayBatch(
        torch.as_tensor(np.ascontiguousarray(origins, np.float32)),
        torch.as_tensor(np.ascontiguousarray(directions, np.float32)),
        torch.as_tensor(np.ascontiguousarray(time_s, np.float64)),
    )


def lidar_batch(
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    time_s: FloatArray,
    depth_m: NDArray[np.float32],
    intensity: NDArray[np.float32],
    returned: NDArray[np.bool_],
    share: float,
    drops: float,
) -> LidarBatch:
    """Rays (N,) of which ``drops`` are drops, drawn of rays of which ``share`` are."""
    weights = (1 - share) / (1 - drops), share / drops if drops else 0.0
    return LidarBatch(
        ray_batch(origins, directions, time_s),
        torch.as_tensor(depth_m).float(),
        torch.as_tensor(intensity).float(),
        torch.as_tensor(returned),
        torch.as_tensor(np.where(returned, *weights)).float(),
    )


def outside_boxes(points: FloatArray, times: FloatArray, actors: Iterable[Actor]) -> BoolArray:
    """Which points (N, 3), world frame, of these times (N,) lie in none of the actors' boxes: (N,)."""
    # sorted by one coordinate, what a box can hold is a slice
    order = np.argsort(points[:, 0])
    ordered, times = points[order], times[order]
    inside = np.zeros(len(points), bool)
    for actor in actors:
        trajectory, enlarged = actor.world_from_actor, np.asarray(actor.size_m) + 0.2
        radius = np.linalg.norm(enlarged) / 2
        low, high = trajectory.positions.min(0) - radius, trajectory.positions.max(0) + radius
        begin, end = np.searchsorted(ordered[:, 0], (low[0], high[0]))
        part = ordered[begin:end]
        near = (part[:, 1] >= low[1]) & (part[:, 1] <= high[1]) & actor.present(times[begin:end])
        at = begin + np.flatnonzero(near)
        # labels of what stands still may waver: it has one pose
        when = times[at] if actor.is_moving else np.full(len(at), (actor.start_s + actor.end_s) / 2)
        close = ((ordered[at] - trajectory.positions_at(when)) ** 2).sum(1) <= radius**2
        at, when = at[close], when[close]
        local = transform_points(invert_pose(trajectory.at(when)), ordered[at][:, None])[:, 0]
        inside[order[at]] |= (np.abs(local) <= enlarged / 2).all(1)
    return ~inside
