"""Rigid poses, trajectories and boxes in numpy.

Conventions, here and everywhere in ``core``: metres, seconds, radians; right-handed, z up; quaternions are wxyz and
unit length; ``world_from_actor`` is the 4x4 matrix that takes actor coordinates to world coordinates; float64.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
UNIT_BOX_CORNERS = np.stack(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5], indexing="ij"), -1).reshape(8, 3)
"""The corners (8, 3) of a box with edges 1 about its centre."""
_PRODUCTS = np.array([[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3]])
"""Indices, among ww, xx, yy, zz, wx, wy, wz, xy, xz, yz, of the products of w, x, y, z with the largest of them."""


def matrix_from_quaternion(quaternion_wxyz: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    quaternion = np.asarray(quaternion_wxyz, np.float64)
    w, x, y, z = (quaternion[..., part] for part in range(4))
    out = np.empty((*quaternion.shape[:-1], 3, 3))  # filled in place: stacking takes several times as long
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return out


def quaternion_from_matrix(rotation: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4) with w >= 0 of rotation matrices (..., 3, 3).

    The largest of the four components is found first, so that no division is by a small number
    (Shepperd, "Quaternion from rotation matrix", 1978).
    """
    r = np.asarray(rotation, np.float64)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    values = np.empty((*r.shape[:-2], 10))
    values[..., 0], values[..., 1] = 1 + xx + yy + zz, 1 + xx - yy - zz
    values[..., 2], values[..., 3] = 1 - xx + yy - zz, 1 - xx - yy + zz
    values[..., 4], values[..., 5] = r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0]
    values[..., 6], values[..., 7] = r[..., 1, 0] - r[..., 0, 1], r[..., 1, 0] + r[..., 0, 1]
    values[..., 8], values[..., 9] = r[..., 2, 0] + r[..., 0, 2], r[..., 2, 1] + r[..., 1, 2]
    q = np.take_along_axis(values, _PRODUCTS[np.argmax(values[..., :4], -1)], -1)
    q = q / np.sqrt((q * q).sum(-1, keepdims=True))
    return np.where(q[..., :1] < 0, -q, q)


def nearest_rotation(matrices: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) that are nearest to matrices (..., 3, 3), by the Frobenius norm."""
    left, _, right = np.linalg.svd(matrices)
    left[..., :, 2] *= np.sign(np.linalg.det(left @ right))[..., None]  # a reflection is no rotation
    return np.asarray(left @ right)


def quaternion_from_yaw(yaw_rad: FloatArray | float) -> FloatArray:
    """Quaternions (..., 4) that turn about +z by ``yaw_rad`` (...), counter-clockwise."""
    half = np.asarray(yaw_rad, np.float64) / 2
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], -1)


def quaternion_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return Hamilton products (..., 4) of quaternions (..., 4): the rotation b, then a."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def rotation_from_angles(yaw_rad: FloatArray, pitch_rad: FloatArray, roll_rad: FloatArray) -> FloatArray:
    """Return rotations (..., 3, 3) of angles (...), radians: yaw about z, then pitch about y (nose down is positive),
    then roll about x (left side up is positive)."""
    (cy, cp, cr), (sy, sp, sr) = ([f(angle) for angle in (yaw_rad, pitch_rad, roll_rad)] for f in (np.cos, np.sin))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def angles_from_rotation(rotation: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return yaw, pitch and roll (...), radians, of rotations (..., 3, 3): the inverse of `rotation_from_angles`."""
    r = np.asarray(rotation, np.float64)
    # numpy's arctan2 of numbers apart in memory has other last bits than of one alone
    xx, yx, zx, zy, zz = np.stack([r[..., 0, 0], r[..., 1, 0], r[..., 2, 0], r[..., 2, 1], r[..., 2, 2]])
    return np.arctan2(yx, xx), np.arctan2(-zx, np.hypot(xx, yx)), np.arctan2(zy, zz)


def slerp(a: FloatArray, b: FloatArray, fraction: FloatArray) -> FloatArray:
    """Spherical interpolation of quaternions (..., 4) along the shorter arc; ``fraction`` (...) may leave [0, 1].
    Between equal ones it is ``a``, to the bit."""
    same = (a == b).all(-1, keepdims=True)
    dot = (a * b).sum(-1, keepdims=True)
    b = np.where(dot < 0, -b, b)
    dot = np.minimum(np.abs(dot), 1.0)
    angle = np.arccos(dot)
    u = np.asarray(fraction)[..., None]
    sine = np.sin(angle)
    near = sine < 1e-6  # nearly parallel: the linear formula is exact to float64 here and divides by nothing
    safe = np.where(near, 1.0, sine)
    wa = np.where(near, 1 - u, np.sin((1 - u) * angle) / safe)
    wb = np.where(near, u, np.sin(u * angle) / safe)
    q = wa * a + wb * b
    return np.where(same, a, q / np.sqrt((q * q).sum(-1, keepdims=True)))


def make_pose(position: FloatArray, quaternion_wxyz: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) of positions (..., 3) and quaternions (..., 4)."""
    position = np.asarray(position, np.float64)
    pose = np.zeros((*position.shape[:-1], 4, 4))
    pose[..., :3, :3] = matrix_from_quaternion(quaternion_wxyz)
    pose[..., :3, 3] = position
    pose[..., 3, 3] = 1
    return pose


def invert_pose(pose: FloatArray) -> FloatArray:
    """Inverse of rigid poses (..., 4, 4)."""
    rotation_t = np.swapaxes(pose[..., :3, :3], -1, -2)
    out = np.zeros_like(pose)
    out[..., :3, :3] = rotation_t
    out[..., :3, 3] = -(rotation_t @ pose[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1
    return out


def transform_points(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Return points (..., N, 3) transformed by poses (..., 4, 4)."""
    return points @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3]


def rotate_vectors(pose: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return directions (..., N, 3) rotated by poses (..., 4, 4)."""
    return vectors @ np.swapaxes(pose[..., :3, :3], -1, -2)


STEADY_M, STEADY_RAD = 0.05, 5e-3
"""Largest deviation, metres and radians, of a sensor from its mean pose on the vehicle at which that pose is its mount.
Recorded poses deviate by as much: those of PandaSet's cameras by up to 18 mm and 0.08 degrees."""


def mean_pose(poses: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the mean (4, 4) of poses (T, 4, 4) that are near to each other, and the largest deviation from it, metres
    and radians."""
    quaternions = quaternion_from_matrix(poses[:, :3, :3])
    quaternions = quaternions * np.where(quaternions @ quaternions[0] < 0, -1.0, 1.0)[:, None]
    middle = quaternions.mean(0)
    middle /= np.linalg.norm(middle)
    mean = make_pose(poses[:, :3, 3].mean(0), middle)
    off_m = float(np.linalg.norm(poses[:, :3, 3] - mean[:3, 3], axis=1).max())
    # unit quaternions of poses an angle apart are 2 sin(angle / 4) apart
    off_rad = float(4 * np.arcsin(np.linalg.norm(quaternions - middle, axis=1).max() / 2))
    return mean, off_m, off_rad


class TrajectoryError(ValueError):
    """Keys that are no trajectory: too few, not finite, not in order, or too many to be worked with."""


@dataclass(frozen=True)
class Trajectory:
    """A moving pose: linear in position, slerp in rotation, carried on at its end velocity outside its times.

    times_s (T,) strictly increasing, positions (T, 3), quaternions_wxyz (T, 4). One key is a pose that stands still.
    start_walked_m: length of the path before the first key, which a part of a trajectory keeps.
    """

    times_s: FloatArray
    positions: FloatArray
    quaternions_wxyz: FloatArray
    start_walked_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("times_s", "positions", "quaternions_wxyz"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), np.float64))
        n = len(self.times_s)
        if (
            n == 0
            or self.times_s.shape != (n,)
            or self.positions.shape != (n, 3)
            or self.quaternions_wxyz.shape != (n, 4)
        ):
            raise TrajectoryError(
                f"a trajectory needs (T,), (T, 3) and (T, 4) with T >= 1, not {self.times_s.shape}, "
                f"{self.positions.shape} and {self.quaternions_wxyz.shape}"
            )
        for name in ("times_s", "positions", "quaternions_wxyz"):
            finite = np.isfinite(getattr(self, name))
            if not finite.all():
                key = int(finite.reshape(n, -1).all(1).argmin())
                raise TrajectoryError(
                    f"key {key} of a trajectory has {name} that are not finite: {getattr(self, name)[key]}"
                )
        late = self.times_s[1:] <= self.times_s[:-1]
        if late.any():
            key = int(late.argmax())
            before, time = self.times_s[key], self.times_s[key + 1]
            raise TrajectoryError(
                f"key {key + 1} of a trajectory at {time} s is not later than the one before, at {before} s"
            )
        norms = np.sqrt((self.quaternions_wxyz * self.quaternions_wxyz).sum(1, keepdims=True))
        off = np.abs(norms - 1)
        if off.max() > 1e-3:
            key = int((off[:, 0] > 1e-3).argmax())
            raise TrajectoryError(f"key {key} of a trajectory has a quaternion of length {norms[key, 0]:.6g}, not 1")
        # re-normalising would change the last bit of what is unit length already
        if off.max() > 1e-9:
            quaternions = np.where(off > 1e-9, self.quaternions_wxyz / norms, self.quaternions_wxyz)
            object.__setattr__(self, "quaternions_wxyz", quaternions)

    @staticmethod
    def from_poses(times_s: FloatArray, poses: FloatArray) -> Trajectory:
        """Return a trajectory of poses (T, 4, 4) at times (T,)."""
        poses = np.asarray(poses, np.float64)
        return Trajectory(np.asarray(times_s, np.float64), poses[:, :3, 3], quaternion_from_matrix(poses[:, :3, :3]))

    @cached_property
    def times_list(self) -> list[float]:
        """The keys' times as a list, which is faster to search."""
        return self.times_s.tolist()

    @cached_property
    def walked_m(self) -> FloatArray:
        """Length (T,) of the path up to each key, metres, in the plane of x and y: the phase of a gait follows it."""
        steps = np.hypot(*np.diff(self.positions[:, :2], axis=0).T)
        return self.start_walked_m + np.concatenate([[0.0], np.cumsum(steps)])

    def walked_at(self, time_s: FloatArray | float) -> FloatArray:
        """Lengths (...) of the path up to times (...), carried on outside the keys."""
        time = np.asarray(time_s, np.float64)
        if len(self.times_s) == 1:
            return np.full(time.shape, self.start_walked_m)
        lower, u = self._between(time)
        return np.asarray(self.walked_m[lower] + u * (self.walked_m[lower + 1] - self.walked_m[lower]))

    @property
    def poses(self) -> FloatArray:
        """The keys as poses (T, 4, 4)."""
        return make_pose(self.positions, self.quaternions_wxyz)

    def at(self, time_s: FloatArray | float) -> FloatArray:
        """Poses (..., 4, 4) at times (...)."""
        time = np.asarray(time_s, np.float64)
        if len(self.times_s) == 1:
            return np.broadcast_to(self.poses[0], (*time.shape, 4, 4)).copy()
        return make_pose(*self.placed_at(time))

    def placed_at(self, time_s: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Positions (..., 3) and quaternions (..., 4) at times (...): `make_pose` of them has the bits of `at`."""
        time = np.asarray(time_s, np.float64)
        if len(self.times_s) == 1:
            shape = time.shape
            return (
                np.broadcast_to(self.positions[0], (*shape, 3)).copy(),
                np.broadcast_to(self.quaternions_wxyz[0], (*shape, 4)).copy(),
            )
        lower, u = self._between(time)
        return self._placed(lower, u), slerp(self.quaternions_wxyz[lower], self.quaternions_wxyz[lower + 1], u)

    def positions_at(self, time_s: FloatArray | float) -> FloatArray:
        """Positions (..., 3) at times (...)."""
        time = np.asarray(time_s, np.float64)
        if len(self.times_s) == 1:
            return np.broadcast_to(self.positions[0], (*time.shape, 3)).copy()
        return self._placed(*self._between(time))

    def _placed(self, lower: NDArray[np.int64], u: FloatArray) -> FloatArray:
        return np.asarray(self.positions[lower] + u[..., None] * (self.positions[lower + 1] - self.positions[lower]))

    def _between(self, time: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the keys before times (...), and the fraction (...) of the way to the next key at each time."""
        lower = np.clip(np.searchsorted(self.times_s, time, side="right") - 1, 0, len(self.times_s) - 2)
        return lower, (time - self.times_s[lower]) / (self.times_s[lower + 1] - self.times_s[lower])

    def between(self, start_s: float, end_s: float) -> Trajectory:
        """Return the trajectory with only the keys that poses from ``start_s`` to ``end_s`` depend on: `at` returns the
        same bits for times between."""
        last = len(self.times_s) - 2
        if last < 1:
            return self
        first, end = np.searchsorted(self.times_s, (start_s, end_s), side="right").tolist()
        first, end = min(max(first - 1, 0), last), min(max(end - 1, 0), last) + 2
        if first == 0 and end == last + 2:
            return self
        # parts of a valid trajectory are valid: nothing is checked or copied again
        part: Trajectory = object.__new__(Trajectory)
        for name in ("times_s", "positions", "quaternions_wxyz"):
            object.__setattr__(part, name, getattr(self, name)[first:end])
        object.__setattr__(part, "start_walked_m", float(self.walked_m[first]))
        return part

    def content(self) -> bytes:
        """Return the keys as bytes, for digests; their number comes first, so the end of the content
        follows from it."""
        arrays = (self.times_s, self.positions, self.quaternions_wxyz)
        return len(self.times_s).to_bytes(4, "little") + b"".join(array.tobytes() for array in arrays)

    def transformed(self, left: FloatArray | None = None, right: FloatArray | None = None) -> Trajectory:
        """Return the trajectory ``left @ pose @ right`` with constant poses (4, 4), or one for each key (T, 4, 4)."""
        poses = self.poses
        if left is not None:
            poses = left @ poses
        if right is not None:
            poses = poses @ right
        return replace(Trajectory.from_poses(self.times_s, poses), start_walked_m=self.start_walked_m)


def split_trajectories(
    times_s: FloatArray,
    positions: FloatArray,
    quaternions_wxyz: FloatArray,
    counts: Sequence[int],
    walked_m: Sequence[float] | None = None,
) -> list[Trajectory]:
    """Split keys (T,), (T, 3), (T, 4) into consecutive trajectories of ``counts`` keys each, faster than one by one.
    ``walked_m`` are their `Trajectory.start_walked_m`.

    Raises `TrajectoryError` as `Trajectory` does.
    """
    ends = np.cumsum(counts, dtype=np.int64)
    parts = [slice(end - count, end) for count, end in zip(counts, ends.tolist(), strict=True)]
    later = np.diff(times_s) > 0
    later[ends[:-1] - 1] = True
    norms = np.sqrt((quaternions_wxyz * quaternions_wxyz).sum(1))
    arrays = times_s, positions, quaternions_wxyz
    sound = (
        later.all() and bool((np.abs(norms - 1) <= 1e-9).all()) and all(np.isfinite(values).all() for values in arrays)
    )
    starts = [0.0] * len(parts) if walked_m is None else walked_m
    if not sound or 0 in counts:
        return [
            Trajectory(times_s[part], positions[part], quaternions_wxyz[part], start)
            for part, start in zip(parts, starts, strict=True)
        ]
    trajectories = []
    for part, start in zip(parts, starts, strict=True):
        trajectory: Trajectory = object.__new__(Trajectory)
        for name, values in zip(("times_s", "positions", "quaternions_wxyz"), arrays, strict=True):
            object.__setattr__(trajectory, name, values[part])
        object.__setattr__(trajectory, "start_walked_m", start)
        trajectories.append(trajectory)
    return trajectories


def placed(trajectory: Trajectory, points: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return points (N, 3) of a moving frame at their times (N,) in the world, for the frame's trajectory."""
    poses = trajectory.at(time_s)
    return np.asarray(np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3])


def box_corners(pose: FloatArray, size_m: FloatArray) -> FloatArray:
    """Return the 8 corners (8, 3) of a box with its centre at ``pose`` (4, 4) and edges ``size_m`` (3,)."""
    return transform_points(pose, UNIT_BOX_CORNERS * np.asarray(size_m))


def points_in_box(points: FloatArray, pose: FloatArray, size_m: FloatArray) -> BoolArray:
    """Return whether points (N, 3) lie in the box with its centre at ``pose`` (4, 4) and edges ``size_m`` (3,), its
    surface included: (N,) bool."""
    assert points.ndim == 2 and points.shape[1] == 3, points.shape
    local = transform_points(invert_pose(pose), points)
    return np.asarray((np.abs(local) <= np.asarray(size_m) / 2).all(-1))


def intersect_boxes(
    origins: FloatArray, directions: FloatArray, box_from_world: FloatArray, size_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where rays enter and leave boxes, by slabs: t_near, t_far (N, A), in lengths of the directions; a ray that
    misses has t_near > t_far.

    origins, directions (N, 3); box_from_world (A, 4, 4) or (N, A, 4, 4) where boxes move with each ray's time; size_m
    (A, 3). t_near may be negative for rays that start inside. Components of direction that are zero are handled by
    the slabs' signs.
    """
    assert origins.shape == directions.shape == (len(origins), 3), (origins.shape, directions.shape)
    pose = box_from_world if box_from_world.ndim == 4 else box_from_world[None]
    o = (
        np.einsum("naij,nj->nai", np.broadcast_to(pose, (len(origins), *pose.shape[1:]))[..., :3, :3], origins)
        + pose[..., :3, 3]
    )
    d = np.einsum("naij,nj->nai", np.broadcast_to(pose, (len(origins), *pose.shape[1:]))[..., :3, :3], directions)
    half = np.asarray(size_m)[None] / 2
    inverse = 1.0 / np.where(np.abs(d) < 1e-300, np.copysign(1e-300, d), d)
    a, b = (-half - o) * inverse, (half - o) * inverse
    return np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)


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
    keep = np.stack([inside, crosses], 2).reshape(pairs, 2 * vertices)
    order = np.argsort(~keep, 1, kind="stable")[:, : vertices + 1]
    last = np.maximum(keep.sum(1) - 1, 0)
    order = np.take_along_axis(order, np.minimum(np.arange(order.shape[1]), last[:, None]), 1)
    out = np.take_along_axis(points, order[..., None], 1)
    out[~keep.any(1)] = 0.0
    return out


def first_in_voxels(points: FloatArray, voxel_m: float) -> NDArray[np.int64]:
    """Return indices of points (N, 3), one in each voxel that holds any, in order."""
    cell = np.floor(points / voxel_m).astype(np.int64)
    cell -= cell.min(0, initial=0)
    span = cell.max(0, initial=0) + 1
    _, first = np.unique((cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2], return_index=True)
    return np.sort(first)


def spread_indices(length: int, count: int) -> NDArray[np.int64]:
    """Return up to ``count`` indices (K,) of ``length`` items, ascending and evenly spread, from the first to the
    last."""
    if length <= count:
        return np.arange(length)
    return np.unique(np.linspace(0, length - 1, count).round().astype(np.int64))


def bilinear(image: NDArray[Any], u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
    """Return values (N, C) of an image (H, W, C) at points u, v (N,), pixels from its corner, bilinear."""
    height, width = image.shape[:2]
    x, y = np.clip(u - 0.5, 0, width - 1), np.clip(v - 0.5, 0, height - 1)
    column, row = np.minimum(x.astype(np.int64), max(width - 2, 0)), np.minimum(y.astype(np.int64), max(height - 2, 0))
    fx, fy = (x - column).astype(np.float32)[:, None], (y - row).astype(np.float32)[:, None]
    right, below = np.minimum(column + 1, width - 1), np.minimum(row + 1, height - 1)
    top = image[row, column] * (1 - fx) + image[row, right] * fx
    bottom = image[below, column] * (1 - fx) + image[below, right] * fx
    return np.asarray(top * (1 - fy) + bottom * fy, np.float32)


def box_sums(values: NDArray[Any], reach: int) -> FloatArray:
    """Return sums (..., H, W) of values over the places within ``reach`` of each in both directions."""
    out = values.astype(np.float64)
    for axis in (-2, -1):
        size = out.shape[axis]
        sums, at = np.cumsum(np.insert(out, 0, 0.0, axis), axis), np.arange(size)
        out = sums.take(np.minimum(at + reach + 1, size), axis) - sums.take(np.maximum(at - reach, 0), axis)
    return out
