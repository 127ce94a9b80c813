"""Estimates from a drive's sweeps of what its files do not state: beams, spin, and, where there are none, poses.

Poses: points on planes, which are estimated from neighbours in beams x columns, are registered point to plane with small_gicp
(Koide, JOSS 2024), and a second registration says how sure they are.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...data.log import PlaneSweep
from ...errors import LogError, remedy_of, what_is_missing
from ...files import cache_folder, file_stamp, write_cached
from ...geometry import (
    FloatArray,
    Trajectory,
    first_in_voxels,
    invert_pose,
    make_pose,
    placed,
    quaternion_from_matrix,
    spread_indices,
)
from ...json_file import Node, read_json
from ...world.drive import LidarModel
from .beams import (
    USUAL,
    WORDS,
    KittiBeams,
    PlanePoints,
    Spin,
    assign_columns,
    assign_rings,
    find_beams,
    fit_spin,
    point_times,
)
from .files import PERIOD_S, KittiFiles, read_points

COLUMN_STEPS = (-4, -2, 0, 2, 4)
RING_STEPS = (-1, 0, 1)
LEAST_NEIGHBOURS = 8
"""Neighbours that tell a plane."""
FLAT_M = 0.03
"""How far neighbours lie from their plane, at most, root mean square."""
WIDE_M = 0.03
WIDER = 4.5
"""A patch is at least this wide, and this many times wider than it is thick: else it is a line."""
NEAR_M, FAR_M = 3.0, 60.0


def find_planes(
    points: FloatArray, ring: NDArray[np.int32], column: NDArray[np.int32], beams: int, columns: int, every: int = 1
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return which points (M,) of a sweep (N, 3) lie on planes, and these's normals (M, 3), which look at the sensor.

    ``ring`` and ``column`` (N,) as in a `Sweep`; those with -1 are left out. Only points of every ``every``-th column
    are looked at.
    """
    known = np.flatnonzero(ring >= 0)
    grid = np.full((beams, columns, 3), np.nan, np.float32)
    index = np.zeros((beams, columns), np.int64)
    grid[ring[known], column[known]] = points[known, :3]
    index[ring[known], column[known]] = known
    distance = np.linalg.norm(grid, axis=-1)
    used = np.flatnonzero(((distance > NEAR_M) & (distance < FAR_M)).ravel())
    used = used[used % columns % every == 0]
    beam, at = np.divmod(used, columns)
    centre, reach = grid[beam, at], 0.05 * distance[beam, at] + 0.3
    count = np.zeros(len(used), np.float32)
    total, products = np.zeros((len(used), 3), np.float32), np.zeros((len(used), 3, 3), np.float32)
    for up in RING_STEPS:
        inside = (beam + up >= 0) & (beam + up < beams)
        for along in COLUMN_STEPS:
            offset = grid[np.clip(beam + up, 0, beams - 1), (at + along) % columns] - centre
            near = inside & (np.linalg.norm(offset, axis=1) < reach)  # nan is no neighbour
            offset[~near] = 0
            count += near
            total += offset
            products += offset[:, :, None] * offset[:, None, :]
    enough = np.flatnonzero(count >= LEAST_NEIGHBOURS)
    mean = total[enough] / count[enough, None]
    spread = products[enough] / count[enough, None, None] - mean[:, :, None] * mean[:, None, :]
    width, axes = np.linalg.eigh(spread.astype(np.float64))
    thick, wide = np.sqrt(np.maximum(width[:, 0], 0)), np.sqrt(np.maximum(width[:, 1], 0))
    flat = (thick < FLAT_M) & (wide > WIDE_M) & (wide > WIDER * thick)
    chosen = index[beam[enough[flat]], at[enough[flat]]]
    normals = axes[flat, :, 0]
    facing = np.sum(normals * points[chosen, :3], 1) > 0
    return chosen, np.where(facing[:, None], -normals, normals)


REACHES_M = (1.0, 0.4, 0.2, 0.1)
"""How far apart points are taken for the same surface, from pass to pass. Wide at first, so that a poor guess does not matter;
narrow at last, so that what moves, and where a ring happens to lie, does not hold the sweep back: on recorded sweeps 0.24 m apart
the first pass alone finds 0.07 m, and the last 0.24 to 0.25 m."""
TARGET_VOXEL_M, SOURCE_VOXEL_M = 0.1, 0.3
NEIGHBOURS = 10
MAP_SWEEPS = 4
"""A sweep is registered to this many before it."""
LEAST_INLIER_SHARE = 0.2
LEAST_INLIERS = 100
"""Fewer points of a sweep, or a smaller share, that find a surface are no registration."""
LEAST_POINTS = 200
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


def register(where: str, frames: Sequence[int], read: Callable[[int], PlaneSweep]) -> Registered:
    """Return the poses of the sweeps of ``frames``, in order of time, at their surfaces' times.

    Raises `LogError` naming ``where`` for sweeps that do not fit each other, or where small_gicp is not installed.
    """
    gicp = _library(where)
    times: list[float] = []
    poses: list[FloatArray] = []
    last: list[FloatArray] = []  # the last sweeps' points, in the first one's frame
    off: list[FloatArray] = []
    step = np.eye(4)  # the motion from one sweep to the next
    first: PlaneSweep | None = None
    for at, frame in enumerate(frames):
        what = f"{where}: the sweep of frame {frame}"
        surface = read(frame)
        if len(surface.points) < LEAST_POINTS:
            raise LogError(f"{what} cannot be registered: {len(surface.points)} of its points lie on planes")
        times.append(surface.middle_s)
        if first is None:
            first = surface
            poses.append(np.eye(4))
            last.append(surface.points)
            continue
        period = times[at] - times[at - 1]
        step = _share_of(step, period / (times[at - 1] - times[at - 2]) if at > 1 else 1.0)
        target = _target(gicp, last)
        for reach in (*REACHES_M, *REACHES_M[-1:]) if at > 1 else REACHES_M + REACHES_M[1:] + REACHES_M[1:]:
            source = _source(gicp, compensated(surface, step, period), surface.normals)
            pose = _align(gicp, target, source, poses[-1] @ step, reach, what)
            step = invert_pose(poses[-1]) @ pose
            if at == 1:  # until now the first sweep's own motion was not known
                last[0] = compensated(first, step, period)
                target = _target(gicp, last)
        poses.append(poses[-1] @ step)
        local = compensated(surface, step, period)
        if at > 1:
            source = _source(gicp, local, surface.normals)
            pose = _align(gicp, _target(gicp, last[-2:-1]), source, poses[-1], REACHES_M[-1], what)
            off.append(invert_pose(poses[-1]) @ pose)
        last = [*last[1 - MAP_SWEEPS :], local @ poses[-1][:3, :3].T + poses[-1][:3, 3]]
    difference = np.array(off).reshape(-1, 4, 4)
    return Registered(
        Trajectory.from_poses(np.array(times), np.stack(poses)),
        np.linalg.norm(difference[:, :3, 3], axis=1),
        np.arccos(np.clip((np.trace(difference[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1)),
    )


def compensated(surface: PlaneSweep, step: FloatArray, period_s: float) -> FloatArray:
    """Return points (N, 3) in the sensor's frame at the surface's time; ``step`` (4, 4) is its motion in a period."""
    motion = Trajectory.from_poses(surface.middle_s + np.array([0.0, period_s]), np.stack([np.eye(4), step]))
    return placed(motion, surface.points, surface.time_s)


def _library(where: str) -> Any:
    try:
        import small_gicp
    except ModuleNotFoundError as error:
        sentence = f"{where}: has no poses, and to find them {what_is_missing(error)}"
        raise LogError(sentence, remedy=remedy_of(error)) from error
    return small_gicp


def _share_of(step: FloatArray, share: float) -> FloatArray:
    """A share of a motion (4, 4)."""
    return np.asarray(Trajectory.from_poses(np.array([0.0, 1.0]), np.stack([np.eye(4), step])).at(share))


def _target(gicp: Any, clouds: Sequence[FloatArray]) -> tuple[Any, Any]:
    points = np.concatenate(clouds)
    cloud = gicp.PointCloud(points[first_in_voxels(points, TARGET_VOXEL_M)])
    tree = gicp.KdTree(cloud)
    gicp.estimate_normals(cloud, tree, NEIGHBOURS)
    return cloud, tree


def _source(gicp: Any, points: FloatArray, normals: FloatArray) -> Any:
    """The points that are registered: of the ground, which tells nothing of the way ahead, no more than of all else."""
    chosen = first_in_voxels(points, SOURCE_VOXEL_M)
    ground = np.abs(normals[chosen, 2]) > UPRIGHT
    others = int((~ground).sum())
    every = max(1, int(ground.sum()) // max(others, LEAST_POINTS))
    return gicp.PointCloud(points[np.concatenate([chosen[~ground], chosen[ground][::every]])])


def _align(gicp: Any, target: tuple[Any, Any], source: Any, guess: FloatArray, reach_m: float, what: str) -> FloatArray:
    cloud, tree = target
    result = gicp.align(
        cloud, source, tree, guess, registration_type="PLANE_ICP", max_correspondence_distance=reach_m,
        max_iterations=50, rotation_epsilon=1e-5, translation_epsilon=1e-4,
    )  # fmt: skip
    pose = np.asarray(result.T_target_source, np.float64)
    share = result.num_inliers / max(source.size(), 1)
    if not np.isfinite(pose).all() or result.num_inliers < LEAST_INLIERS or share < LEAST_INLIER_SHARE:
        raise LogError(f"{what} does not fit those before it: {share:.0%} of its points find a surface")
    # a rotation to the last bit: what is off grows with every product, and after a dozen sweeps is all there is
    return make_pose(pose[:3, 3], quaternion_from_matrix(pose[:3, :3]))


VERSION = 2
"""Counted on whenever what is found changes: what an older program kept is found anew."""
BEAM_SWEEPS = 4
TRIED_SWEEPS = 20
"""The spin is told by so many sweeps in the middle of the drive."""
SPIN_EVERY = 3
"""Every third column of a sweep tells the spin well enough."""


@dataclass(frozen=True)
class LidarCalibration:
    """Beams and spin of the LiDAR; its poses where the drive has none, with the sentence on how sure they are."""

    beams: KittiBeams
    spin: Spin
    trajectory: Trajectory | None
    sentence: str


def find(
    path: Path, files: KittiFiles, world_from_lidar: Trajectory | None, stated: LidarModel | None = None
) -> LidarCalibration | None:
    """Return what the sweeps tell, ``world_from_lidar`` given where the drive has poses, and ``stated`` where it says which way
    the LiDAR turns, and which beams it has, if any; None where there are no sweeps.

    Raises `LogError`.
    """
    if not files.sweeps:
        return None
    direction = None if stated is None else stated.direction
    if stated is not None and stated.beams and world_from_lidar is not None:
        flat = np.zeros(stated.beams)
        beams = KittiBeams(stated.elevation_rad, flat, stated.azimuth_offset_rad, stated.columns, stated=True)
        return LidarCalibration(beams, _stated_spin(stated.direction), None, "")
    cached = cache_folder() / "kitti" / f"{_identity(files, world_from_lidar, direction)}.json"
    if cached.is_file():
        try:
            return _from_json(Node(read_json(cached, LogError), f"{cached}: ", LogError))
        except LogError:
            pass  # a broken one is found and written anew
    calibration = _find(path, files, world_from_lidar, direction)
    write_cached(cached, json.dumps(_to_json(calibration)).encode())
    return calibration


def _find(
    path: Path, files: KittiFiles, world_from_lidar: Trajectory | None, direction: int | None
) -> LidarCalibration:
    frames = sorted(files.sweeps)
    chosen = [frames[at] for at in spread_indices(len(frames), BEAM_SWEEPS)]
    beams = find_beams([read_points(files.sweeps[frame]) for frame in chosen])
    if beams is None:
        raise LogError(
            f"{files.sweeps[chosen[0]]}: shows no rings of a turning LiDAR, nor do {len(chosen) - 1} other sweeps"
        )

    read = _planes_of(files, beams, 1 if world_from_lidar is None else SPIN_EVERY)
    if world_from_lidar is not None and direction is not None:
        return LidarCalibration(beams, _stated_spin(direction), None, "")
    if world_from_lidar is not None:
        return LidarCalibration(beams, fit_spin(_stretch(frames), read, files.turns, world_from_lidar), None, "")
    if len(frames) < 2:
        raise LogError(f"{path}: has no poses, and a single sweep tells none")
    # as if each sweep were taken in a moment, which favours neither direction
    still = _registered(path, files, read, _stretch(frames), 0)
    spin = fit_spin(_stretch(frames), read, files.turns, still.trajectory)
    registered = _registered(path, files, read, frames, spin.direction)
    return LidarCalibration(beams, spin, registered.trajectory, registered.sentence())


def _stated_spin(direction: int) -> Spin:
    return Spin(direction, True, f"the LiDAR turns {WORDS[direction]}, as the drive says")


def _stretch(frames: list[int]) -> list[int]:
    """The frames in the middle that the spin is told by."""
    first = max(0, (len(frames) - TRIED_SWEEPS) // 2)
    return frames[first : first + TRIED_SWEEPS]


def _planes_of(files: KittiFiles, beams: KittiBeams, every: int) -> Callable[[int], PlanePoints]:
    model = beams.model(USUAL, PERIOD_S)

    @lru_cache(maxsize=TRIED_SWEEPS)
    def planes(frame: int) -> PlanePoints:
        points = read_points(files.sweeps[frame])
        ring = assign_rings(points, beams)
        chosen, normals = find_planes(
            points, ring, assign_columns(points, ring, model), model.beams, model.columns, every
        )
        return PlanePoints(points[chosen, :3], normals)

    return planes


def _registered(
    path: Path, files: KittiFiles, read: Callable[[int], PlanePoints], frames: list[int], spin: int
) -> Registered:
    def surface(frame: int) -> PlaneSweep:
        planes, turn = read(frame), files.turns[frame]
        return PlaneSweep(planes.points, planes.normals, point_times(planes.points, turn, spin), turn[1])

    return register(str(path), frames, surface)


def _identity(files: KittiFiles, world_from_lidar: Trajectory | None, direction: int | None) -> str:
    digest = hashlib.sha256(f"{VERSION}{direction or ''}".encode())
    for frame, path in sorted(files.sweeps.items()):
        digest.update(f"{path.resolve()} {file_stamp(path)} {files.turns[frame]}\n".encode())
    digest.update(b"" if world_from_lidar is None else world_from_lidar.content())
    return digest.hexdigest()[:32]


def _to_json(calibration: LidarCalibration) -> dict[str, object]:
    beams, spin, track = calibration.beams, calibration.spin, calibration.trajectory
    return {
        "elevation_rad": beams.elevation_rad.tolist(),
        "height_m": beams.height_m.tolist(),
        "azimuth_offset_rad": beams.azimuth_offset_rad.tolist(),
        "columns": beams.columns,
        "direction": spin.direction,
        "told": spin.is_measured,
        "spin": spin.sentence,
        "times_s": [] if track is None else track.times_s.tolist(),
        "positions": [] if track is None else track.positions.tolist(),
        "quaternions_wxyz": [] if track is None else track.quaternions_wxyz.tolist(),
        "sentence": calibration.sentence,
    }


def _from_json(node: Node) -> LidarCalibration:
    elevation = node.key("elevation_rad").array(-1)
    beams = KittiBeams(
        elevation,
        node.key("height_m").array(len(elevation)),
        node.key("azimuth_offset_rad").array(len(elevation)),
        node.key("columns").integer(at_least=1),
    )
    spin = Spin(node.key("direction").integer(), node.key("told").flag(), node.key("spin").text())
    times = node.key("times_s").array(-1)
    track = (
        Trajectory(times, node.key("positions").array(-1, 3), node.key("quaternions_wxyz").array(-1, 4))
        if len(times)
        else None
    )
    return LidarCalibration(beams, spin, track, node.key("sentence").text())
