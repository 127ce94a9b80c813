"""Poses of a LiDAR by registration of its sweeps, point to plane, with small_gicp (Koide, JOSS 2024), and how sure they are.

Nearest neighbours in space will not do: far from the sensor they lie along one ring, and tell no plane. What they tell instead
moves along with the sensor, and holds a registration back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ....errors import LogError, what_is_missing
from ....geometry import FloatArray, Trajectory, invert_pose, make_pose, quaternion_from_matrix
from .planes import SweepPlanes, one_a_voxel

REACHES_M = (1.0, 0.4, 0.2, 0.1)
"""How far apart points are taken for the same surface, from pass to pass. Wide at first, so that a poor guess does not matter;
narrow at last, so that what moves, and where a ring happens to lie, does not hold the sweep back: on recorded sweeps 0.24 m apart
the first pass alone finds 0.07 m, and the last 0.24 to 0.25 m."""
TARGET_VOXEL_M, SOURCE_VOXEL_M = 0.1, 0.3
NEIGHBOURS = 10
MAP_SWEEPS = 4
"""A sweep is registered to this many before it."""
FEWEST_SHARE = 0.2
FEWEST = 100
"""Fewer points of a sweep, or a smaller share, that find a surface are no registration."""
FEWEST_POINTS = 200
UPRIGHT = 0.9


@dataclass(frozen=True)
class Registered:
    """The LiDAR's trajectory, from its first sweep's frame, and what is known of its error.

    ``off_m``, ``off_rad`` (T - 2,): by how much each sweep's pose differs, registered to the one two before it alone.
    """

    trajectory: Trajectory
    off_m: FloatArray
    off_rad: FloatArray

    def sentence(self) -> str:
        """Return what is to be said of the poses."""
        about = f"there are no poses: those of {len(self.trajectory.times_s)} sweeps were found by registration"
        if not len(self.off_m):
            return f"{about}, and nothing tells how sure they are"
        return (
            f"{about}, over two sweeps sure to {np.median(self.off_m) * 100:.1f} cm and "
            f"{np.degrees(np.median(self.off_rad)):.3f} degrees (median; at worst {self.off_m.max() * 100:.1f} cm and "
            f"{np.degrees(self.off_rad.max()):.3f} degrees), and errors add up along the drive"
        )


def register(where: str, frames: Sequence[int], read: Callable[[int], SweepPlanes]) -> Registered:
    """Return the poses of the sweeps of ``frames``, in order of time, at their surfaces' times.

    Raises `LogError` naming ``where`` for sweeps that do not fit each other, or where small_gicp is not installed.
    """
    gicp = _library(where)
    times: list[float] = []
    poses: list[FloatArray] = []
    placed: list[FloatArray] = []  # the last sweeps' points, in the first one's frame
    off: list[FloatArray] = []
    step = np.eye(4)  # the motion from one sweep to the next
    first: SweepPlanes | None = None
    for at, frame in enumerate(frames):
        what = f"{where}: the sweep of frame {frame}"
        surface = read(frame)
        if len(surface.points) < FEWEST_POINTS:
            raise LogError(f"{what} cannot be registered: {len(surface.points)} of its points lie on planes")
        times.append(surface.time_s)
        if first is None:
            first = surface
            poses.append(np.eye(4))
            placed.append(surface.points)
            continue
        period = times[at] - times[at - 1]
        step = _share_of(step, period / (times[at - 1] - times[at - 2]) if at > 1 else 1.0)
        target = _target(gicp, placed)
        for reach in (*REACHES_M, *REACHES_M[-1:]) if at > 1 else REACHES_M + REACHES_M[1:] + REACHES_M[1:]:
            source = _source(gicp, compensated(surface, step, period), surface.normals)
            found = _align(gicp, target, source, poses[-1] @ step, reach, what)
            step = invert_pose(poses[-1]) @ found
            if at == 1:  # until now the first sweep's own motion was not known
                placed[0] = compensated(first, step, period)
                target = _target(gicp, placed)
        poses.append(poses[-1] @ step)
        local = compensated(surface, step, period)
        if at > 1:
            source = _source(gicp, local, surface.normals)
            found = _align(gicp, _target(gicp, placed[-2:-1]), source, poses[-1], REACHES_M[-1], what)
            off.append(invert_pose(poses[-1]) @ found)
        placed = [*placed[1 - MAP_SWEEPS :], local @ poses[-1][:3, :3].T + poses[-1][:3, 3]]
    difference = np.array(off).reshape(-1, 4, 4)
    return Registered(
        Trajectory.from_poses(np.array(times), np.stack(poses)),
        np.linalg.norm(difference[:, :3, 3], axis=1),
        np.arccos(np.clip((np.trace(difference[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1)),
    )


def compensated(surface: SweepPlanes, step: FloatArray, period_s: float) -> FloatArray:
    """Return points (N, 3) in the sensor's frame at the surface's time; ``step`` (4, 4) is its motion in a period."""
    poses = Trajectory.from_poses(np.array([0.0, 1.0]), np.stack([np.eye(4), step])).at(surface.late_s / period_s)
    return np.asarray(np.einsum("nij,nj->ni", poses[:, :3, :3], surface.points) + poses[:, :3, 3])


def _library(where: str) -> Any:
    try:
        import small_gicp
    except ModuleNotFoundError as error:
        raise LogError(f"{where}: has no poses, and to find them {what_is_missing(error)}") from error
    return small_gicp


def _share_of(step: FloatArray, share: float) -> FloatArray:
    """A share of a motion (4, 4)."""
    return np.asarray(Trajectory.from_poses(np.array([0.0, 1.0]), np.stack([np.eye(4), step])).at(share))


def _target(gicp: Any, placed: Sequence[FloatArray]) -> tuple[Any, Any]:
    points = np.concatenate(placed)
    cloud = gicp.PointCloud(points[one_a_voxel(points, TARGET_VOXEL_M)])
    tree = gicp.KdTree(cloud)
    gicp.estimate_normals(cloud, tree, NEIGHBOURS)
    return cloud, tree


def _source(gicp: Any, points: FloatArray, normals: FloatArray) -> Any:
    """The points that are registered: of the ground, which tells nothing of the way ahead, no more than of all else."""
    chosen = one_a_voxel(points, SOURCE_VOXEL_M)
    ground = np.abs(normals[chosen, 2]) > UPRIGHT
    others = int((~ground).sum())
    every = max(1, int(ground.sum()) // max(others, FEWEST_POINTS))
    return gicp.PointCloud(points[np.concatenate([chosen[~ground], chosen[ground][::every]])])


def _align(gicp: Any, target: tuple[Any, Any], source: Any, guess: FloatArray, reach_m: float, what: str) -> FloatArray:
    cloud, tree = target
    result = gicp.align(
        cloud, source, tree, guess, registration_type="PLANE_ICP", max_correspondence_distance=reach_m,
        max_iterations=50, rotation_epsilon=1e-5, translation_epsilon=1e-4,
    )  # fmt: skip
    found = np.asarray(result.T_target_source, np.float64)
    share = result.num_inliers / max(source.size(), 1)
    if not np.isfinite(found).all() or result.num_inliers < FEWEST or share < FEWEST_SHARE:
        raise LogError(f"{what} does not fit those before it: {share:.0%} of its points find a surface")
    # a rotation to the last bit: what is off grows with every product, and after a dozen sweeps is all there is
    return make_pose(found[:3, 3], quaternion_from_matrix(found[:3, :3]))
