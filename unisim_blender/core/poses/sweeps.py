"""Sweeps as planes: thinned points with normals, in the sensor's frame at each point's own time, without what moves."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..data.log import Log, PlaneSweep, Sweep
from ..errors import LogError, remedy_of, what_is_missing
from ..geometry import BoolArray, FloatArray, Trajectory, first_in_voxels, invert_pose, placed
from ..world.drive import Drive

NEAR_M, FAR_M = 2.5, 80.0
VOXEL_M = 0.2
NEIGHBOURS = 10
FLAT_M, WIDE_M, WIDER = 0.04, 0.08, 3.0
"""Neighbours are on a plane where they lie at most this far from it (root mean square), and are this wide and this many
times wider than thick: else they are a line."""
BOX_MARGIN_M = 0.3


def import_scipy(purpose: str) -> Any:
    """Return `scipy.spatial`. Raises `LogError` that names ``purpose`` where scipy is not installed."""
    try:
        import scipy.spatial
    except ModuleNotFoundError as error:
        raise LogError(f"{purpose} {what_is_missing(error)}", remedy=remedy_of(error)) from error
    return scipy.spatial


def reference_lidar(log: Log) -> str | None:
    """Return the name of the LiDAR whose sweeps the ego's trajectory is measured by: of those that ride on the vehicle,
    one with a beam table if there is any, of these the one with most sweeps; None without two sweeps."""
    counts = {
        name: (lidar.model.beams > 0, len(log.sweep_frames(name)))
        for name, lidar in log.drive.lidars.items()
        if not lidar.sees_ego_body and len(log.sweep_frames(name)) > 1
    }
    return max(counts, key=lambda name: counts[name], default=None)


def in_moving_boxes(drive: Drive, points: FloatArray, time_s: FloatArray) -> BoolArray:
    """Return whether points (N, 3) of the world lie inside a moving actor's box, or near it, at their times (N,)."""
    inside = np.zeros(len(points), np.bool_)
    for actor in drive.actors.values():
        half = actor.size_m / 2 + BOX_MARGIN_M
        if not actor.is_moving:
            continue
        middle = actor.world_from_actor.at(float(np.median(time_s)) if len(time_s) else 0.0)
        reach = float(np.linalg.norm(half)) + 5.0  # what it moves within a sweep
        near = np.flatnonzero(np.linalg.norm(points - middle[:3, 3], axis=1) < reach)
        if len(near):
            local = np.einsum(
                "nij,nj->ni",
                (to_box := invert_pose(actor.world_from_actor.at(time_s[near])))[:, :3, :3],
                points[near],
            )
            inside[near] |= (np.abs(local + to_box[:, :3, 3]) < half).all(1)
    return inside


def standing(log: Log, lidar: str, frame: int) -> tuple[FloatArray, FloatArray]:
    """Return the returns (N, 3) of a sweep that lie in no moving actor's box, in the sensor's frame at their own times
    (N,), seconds."""
    sweep: Sweep = log.sweep(lidar, frame)
    distance = np.linalg.norm(sweep.points - sweep.origins, axis=1)
    keep = (distance > NEAR_M) & (distance < FAR_M) & np.isfinite(sweep.points).all(1)
    if sweep.rank is not None:
        keep &= sweep.rank == 0
    points, time_s = sweep.points[keep], sweep.time_s[keep]
    keep = ~in_moving_boxes(log.drive, points, time_s)
    points, time_s = points[keep], time_s[keep]
    to_sensor = invert_pose(log.drive.lidars[lidar].world_from_lidar.at(time_s))
    return np.einsum("nij,nj->ni", to_sensor[:, :3, :3], points) + to_sensor[:, :3, 3], time_s


def planes_of(points: FloatArray, time_s: FloatArray, trajectory: Trajectory) -> PlaneSweep:
    """Return the planes of a sweep's points (N, 3), in the sensor's frame at their times (N,).

    Normals are of the points as ``trajectory`` places them, of a rolling sweep without its motion.
    """
    spatial = import_scipy("to find planes in sweeps")
    middle_s = float(np.median(time_s)) if len(time_s) else 0.0
    still = placed(trajectory, points, time_s)
    chosen = first_in_voxels(still, VOXEL_M)
    thinned = still[chosen]
    if len(chosen) <= NEIGHBOURS:
        empty = np.zeros((0, 3))
        return PlaneSweep(empty, empty, np.zeros(0), middle_s)
    distance, near = spatial.cKDTree(thinned).query(thinned, NEIGHBOURS, workers=-1)
    offset = thinned[near] - thinned[near].mean(1, keepdims=True)
    width, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset) / NEIGHBOURS)
    thick, wide = (np.sqrt(np.maximum(width[:, k], 0)) for k in (0, 1))
    flat = (thick < FLAT_M) & (wide > WIDE_M) & (wide > WIDER * thick) & (distance[:, -1] < 1.5)
    poses = trajectory.at(time_s[chosen[flat]])
    normals = np.einsum("nji,nj->ni", poses[:, :3, :3], axes[flat, :, 0])
    return PlaneSweep(points[chosen[flat]], normals, time_s[chosen[flat]], middle_s)
