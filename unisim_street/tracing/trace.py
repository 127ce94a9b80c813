"""First hits of rays among placed assets: culled by bundle, exact by part.

A `AssetPlacement` puts an asset into the world: where it stands it is static, or it moves with an actor, or it is what a box
of the static world holds, copied elsewhere. Actors are where they are at each ray's own time. A bundle is coherent rays with a
frustum that holds them all, by which what they cannot hit is skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import (
    BoolArray,
    FloatArray,
    Trajectory,
    intersect_boxes,
    invert_pose,
    transform_points,
)
from unisim_blender.core.world.drive import Box

from ..paint.materials import Material
from .shapes import TracedShape

_CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(8, 3).astype(bool)
_TURN_PADDING_M = 0.01
"""Room for a turning actor's corners, which leave the straight lines between sampled times a little."""


@dataclass(frozen=True, eq=False)
class AssetPart:
    """One solid of an asset: a shape, a material, and the shape's pose in the asset (4, 4), None
    where they coincide."""

    shape: TracedShape
    material: Material
    asset_from_part: FloatArray | None = None

    @cached_property
    def part_from_asset(self) -> FloatArray | None:
        """The inverse pose."""
        return None if self.asset_from_part is None else invert_pose(self.asset_from_part)

    def corners(self) -> FloatArray:
        """Corners (8, 3) of the bounding box, asset frame."""
        corners = np.where(_CORNERS, self.shape.high, self.shape.low)
        return corners if self.asset_from_part is None else transform_points(self.asset_from_part, corners)

    def to_part(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rays (N, 3), (N, 3) of the asset's frame in the part's."""
        if self.part_from_asset is None:
            return origins, directions
        rotation = self.part_from_asset[:3, :3].T
        return origins @ rotation + self.part_from_asset[:3, 3], directions @ rotation


@dataclass(frozen=True, eq=False)
class Limb:
    """An asset along z that moves in another's frame, from joint ``root`` to joint ``tip``: functions from phases (N,), in
    cycles, to places (N, 3)."""

    asset: Asset
    root: Callable[[FloatArray], FloatArray]
    tip: Callable[[FloatArray], FloatArray]

    def poses(self, phase: FloatArray) -> FloatArray:
        """Poses (N, 4, 4) of the limb's frame in the asset's at phases (N,); its y axis lies across."""
        root = self.root(phase)
        z = self.tip(phase) - root
        z = z / np.linalg.norm(z, axis=1, keepdims=True)
        x = np.cross([0.0, 1.0, 0.0], z)
        x = x / np.linalg.norm(x, axis=1, keepdims=True)
        out = np.tile(np.eye(4), (len(phase), 1, 1))
        out[:, :3, :3] = np.stack([x, np.cross(z, x), z], -1)
        out[:, :3, 3] = root
        return out


_LIMB_STEP_S = 0.01
"""Seconds between poses of limbs, which move evenly between them."""


@dataclass(frozen=True, eq=False)
class Asset:
    """An object made of parts, in its own frame. ``limbs`` move with its phase, whose cycle is ``cycle_m`` metres of path."""

    name: str
    parts: tuple[AssetPart, ...]
    limbs: tuple[Limb, ...] = ()
    cycle_m: float = 1.0

    @cached_property
    def corners(self) -> FloatArray:
        """Corners (P, 8, 3) of the parts' bounding boxes."""
        return np.stack([part.corners() for part in self.parts])


@dataclass(frozen=True, eq=False)
class AssetPlacement:
    """An asset in the world. ``motion`` None: it stands with its frame on the world's.

    window: seconds in which it is there. clip: the box, in the asset's frame, outside which nothing of it counts.
    holes: boxes, in the asset's frame, inside which nothing of it counts.
    scale: how many times larger than the asset it is, along the asset's axes; None for as large.
    """

    name: str
    asset: Asset
    motion: Trajectory | None = None
    window: tuple[float, float] | None = None
    clip: Box | None = None
    holes: tuple[Box, ...] = ()
    scale: FloatArray | None = None

    def bounds(self, start_s: float, end_s: float) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """low, high (P, 3), world frame, of the parts that may matter between two times, and their numbers (P,)."""
        corners = self.asset.corners
        keep = np.arange(len(corners))
        if self.clip is not None:
            reached = boxes_meet(corners, self.clip)
            keep, corners = keep[reached], corners[reached]
        if self.scale is not None:
            corners = corners * self.scale
        if self.motion is not None:
            inside = self.motion.times_s[(self.motion.times_s > start_s) & (self.motion.times_s < end_s)]
            poses = self.motion.at(np.unique(np.concatenate([inside, np.linspace(start_s, end_s, 9)])))
            corners = np.concatenate([corners @ pose[:3, :3].T + pose[:3, 3] for pose in poses], 1)
        return corners.min(1) - _TURN_PADDING_M, corners.max(1) + _TURN_PADDING_M, keep

    def limbs(self) -> Iterator[AssetPlacement]:
        """The asset's limbs, placed where the length of the path has them, while the asset is there."""
        assert self.motion is not None
        scale = np.ones(3) if self.scale is None else self.scale
        for limb in self.asset.limbs:
            start_s, end_s = self.window or (float(self.motion.times_s[0]), float(self.motion.times_s[-1]))
            # on a grid of its own: a part of a trajectory has limbs at the same places
            times = _LIMB_STEP_S * np.arange(np.floor(start_s / _LIMB_STEP_S), np.ceil(end_s / _LIMB_STEP_S) + 2)
            poses = limb.poses(self.motion.walked_at(times) / (self.asset.cycle_m * scale[0]))
            poses[:, :3, 3] *= scale
            motion = Trajectory.from_poses(times, self.motion.at(times) @ poses)
            yield AssetPlacement(self.name, limb.asset, motion, self.window, scale=self.scale)


@dataclass
class Hits:
    """t (B, K) inf where nothing was hit; placement, part (B, K) numbers, -1 where nothing was."""

    t: FloatArray
    placement: NDArray[np.int16]
    part: NDArray[np.int16]


def boxes_meet(corners: FloatArray, box: Box) -> NDArray[np.bool_]:
    """Whether boxes with corners (P, 8, 3) may reach into a box: (P,), never wrongly False."""
    local = transform_points(invert_pose(box.world_from_box), corners.reshape(-1, 3)).reshape(corners.shape)
    half = np.asarray(box.size_m) / 2 + 1e-6
    return np.asarray(((local.min(1) <= half) & (local.max(1) >= -half)).all(-1))


def trace(placements: list[AssetPlacement], bundles: Bundles) -> Hits:
    """The nearest hit of every ray."""
    shape = bundles.shape
    hits = Hits(np.full(shape, np.inf), np.full(shape, -1, np.int16), np.full(shape, -1, np.int16))
    start_s, end_s = float(bundles.time_s.min()), float(bundles.time_s.max())
    for number, placement in enumerate(placements):
        if placement.window is not None and (end_s < placement.window[0] or start_s > placement.window[1]):
            continue
        low, high, parts = placement.bounds(start_s, end_s)
        if not len(parts):
            continue
        rows = np.flatnonzero(may_meet(bundles.planes, low.min(0)[None], high.max(0)[None])[:, 0])
        if len(rows):
            _trace_placement(number, placement, parts, rows, may_meet(bundles.planes[rows], low, high), bundles, hits)
    return hits


def _trace_placement(
    number: int,
    placement: AssetPlacement,
    parts: NDArray[np.int64],
    rows: NDArray[np.int64],
    candidates: NDArray[np.bool_],
    bundles: Bundles,
    hits: Hits,
) -> None:
    """Put a placement's hits of the bundles ``rows`` (R,) into ``hits``; candidates (R, P)."""
    used = candidates.any(1)
    rows, candidates = rows[used], candidates[used]
    k = bundles.shape[1]
    o, d = bundles.origins[rows].reshape(-1, 3), bundles.directions[rows].reshape(-1, 3)
    time = bundles.time_s[rows].reshape(-1)
    o, d, stretch = into_asset(placement, o, d, time)
    t_min = np.zeros(len(o))
    t_max = np.full(len(o), np.inf)
    if placement.window is not None:
        t_max[(time < placement.window[0]) | (time > placement.window[1])] = -np.inf
    if placement.clip is not None:
        near, far = intersect_boxes(o, d, invert_pose(placement.clip.world_from_box)[None], placement.clip.size_m[None])
        t_min, t_max = np.maximum(near[:, 0], 0.0), np.minimum(t_max, far[:, 0])
        t_max = np.where(t_min <= t_max, t_max, -np.inf)
    cut = np.zeros(len(placement.asset.parts), bool)
    for hole in placement.holes:
        cut |= boxes_meet(placement.asset.corners, hole)
    for column, index in enumerate(parts):
        chosen = np.flatnonzero(candidates[:, column])
        if not len(chosen):
            continue
        rays = (chosen[:, None] * k + np.arange(k)).reshape(-1)
        part = placement.asset.parts[index]
        if cut[index]:
            t = _first_outside(part, o[rays], d[rays], t_min[rays], placement.holes)
        else:
            t = part.shape.intersect(*part.to_part(o[rays], d[rays]), t_min[rays])
        if stretch is not None:
            t = t / stretch[rays]
        t[t > t_max[rays]] = np.inf
        target = rows[chosen]
        t = t.reshape(len(chosen), k)
        better = t < hits.t[target]
        hits.t[target] = np.where(better, t, hits.t[target])
        hits.placement[target] = np.where(better, np.int16(number), hits.placement[target])
        hits.part[target] = np.where(better, np.int16(index), hits.part[target])


def into_asset(
    placement: AssetPlacement, origins: FloatArray, directions: FloatArray, time_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Rays (N, 3), (N, 3) at times (N,) in the frame and the metres of a placement's asset, with unit directions; and
    how many of these metres a metre of each ray is (N,), None where the placement has no scale."""
    o, d = (
        (origins, directions) if placement.motion is None else to_asset(placement.motion, origins, directions, time_s)
    )
    if placement.scale is None:
        return o, d, None
    o, d = o / placement.scale, d / placement.scale
    stretch = np.linalg.norm(d, axis=1)
    return o, d / stretch[:, None], stretch


def to_asset(
    motion: Trajectory, origins: FloatArray, directions: FloatArray, time_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rays (N, 3), (N, 3) at times (N,) in the frame of what moves."""
    if len(motion.times_s) == 1:
        pose = motion.poses[0]
        return (origins - pose[:3, 3]) @ pose[:3, :3], directions @ pose[:3, :3]
    times, which = np.unique(time_s, return_inverse=True)  # an image row's or a column's rays share one time
    poses = motion.at(times)
    rotation = poses[which, :3, :3]
    return (
        np.einsum("ni,nij->nj", origins - poses[which, :3, 3], rotation),
        np.einsum("ni,nij->nj", directions, rotation),
    )


def _first_outside(
    part: AssetPart, origins: FloatArray, directions: FloatArray, t_min: FloatArray, holes: tuple[Box, ...]
) -> FloatArray:
    """First t (N,) at which rays are in the part and in no hole: what a hole cuts through shows its cut."""
    o, d = part.to_part(origins, directions)
    t = part.shape.intersect(o, d, t_min)
    boxes = np.stack([invert_pose(hole.world_from_box) for hole in holes])
    near, far = intersect_boxes(origins, directions, boxes, np.stack([hole.size_m for hole in holes]))
    for _ in range(2 * len(holes) + 1):
        inside = (near <= t[:, None]) & (t[:, None] < far - 1e-9) & np.isfinite(t)[:, None]
        rows = np.flatnonzero(inside.any(1))
        if not len(rows):
            return t
        leave = np.where(inside[rows], far[rows], -np.inf).max(1)
        t[rows] = part.shape.intersect(o[rows], d[rows], leave)
    return t


def lit(
    placements: list[AssetPlacement],
    points: FloatArray,
    directions: FloatArray,
    time_s: FloatArray,
    reach_m: FloatArray | float = np.inf,
) -> NDArray[np.bool_]:
    """Whether nothing stands between points (N, 3) and the light along unit ``directions`` (N, 3), ``reach_m`` (N,) away: (N,).
    Directions that are almost parallel, or meet in a point, make it fast."""
    n = len(points)
    if n == 0:
        return np.zeros(0, bool)
    k = 256
    order = bundle_points(points, directions[0])
    order = np.concatenate([order, np.full(-n % k, order[-1])]).reshape(-1, k)
    hits = trace(placements, make_bundles(points[order], directions[order], time_s[order]))
    out = np.empty(n, bool)
    reach = np.broadcast_to(reach_m, n)[order.reshape(-1)]
    out[order.reshape(-1)] = ~np.isfinite(hits.t).reshape(-1) | (hits.t.reshape(-1) > reach)
    return out


TILE_PX = 16
"""Rays of an image are bundled by tiles of TILE x TILE; a bundle holds TILE ** 2 rays."""

_FRUSTUM_MARGIN_M = 2e-3  # the frusta are compared in float32


@dataclass(frozen=True)
class Bundles:
    """origins, directions (B, K, 3) and time_s (B, K) of B bundles of K rays, world frame.

    planes (B, 5, 4): every point o + t d, t >= 0, of a bundle's rays has ``plane[:3] . x <= plane[3]``.
    """

    origins: FloatArray
    directions: FloatArray
    time_s: FloatArray
    planes: NDArray[np.float32]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of bundles, and of rays in each."""
        return self.time_s.shape[0], self.time_s.shape[1]


def make_bundles(origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> Bundles:
    """Bundles of rays (B, K, 3), (B, K, 3), (B, K); a bundle whose rays spread over 80 degrees or more
    is never skipped."""
    axis = directions.mean(1)
    axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
    # the side axis follows the horizon, as image rows and LiDAR rings do, which keeps the frusta tight
    side = np.cross(axis, [0.0, 0.0, 1.0])
    steep = np.linalg.norm(side, axis=-1) < 1e-3
    side[steep] = np.cross(axis[steep], [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    up = np.cross(side, axis)
    ahead = (directions @ axis[:, :, None])[..., 0]
    open_bundle = ahead.min(1) < 0.2
    planes = np.zeros((len(axis), 5, 4))
    for i, outward in enumerate((side, -side, up, -up)):
        slope = ((directions @ outward[:, :, None])[..., 0] / np.maximum(ahead, 0.2)).max(1)
        planes[:, i, :3] = outward - slope[:, None] * axis
    planes[:, 4, :3] = -axis
    planes[..., 3] = np.einsum("bki,bpi->bkp", origins, planes[..., :3]).max(1) + _FRUSTUM_MARGIN_M
    planes[open_bundle] = [0.0, 0.0, 0.0, 1.0]
    return Bundles(origins, directions, time_s, planes.astype(np.float32))


def may_meet(planes: NDArray[np.float32], low: FloatArray, high: FloatArray) -> BoolArray:
    """Whether bundles with planes (B, 5, 4) may hit boxes from low to high (P, 3): (B, P) bool,
    never wrongly False."""
    middle, half = ((low + high) / 2).astype(np.float32), ((high - low) / 2).astype(np.float32)
    out = np.ones((len(planes), len(low)), bool)
    for i in range(planes.shape[1]):
        normal = planes[:, i, :3]
        out &= normal @ middle.T - np.abs(normal) @ half.T <= planes[:, i, 3:]
    return out


def tile_image(values: FloatArray) -> FloatArray:
    """An image (H, W, ...) as tiles (B, TILE ** 2, ...), its edges repeated to whole tiles."""
    height, width = values.shape[:2]
    rows = np.minimum(np.arange(-(-height // TILE_PX) * TILE_PX), height - 1)
    columns = np.minimum(np.arange(-(-width // TILE_PX) * TILE_PX), width - 1)
    padded = values[rows][:, columns]
    tail = values.shape[2:]
    split = padded.reshape(len(rows) // TILE_PX, TILE_PX, len(columns) // TILE_PX, TILE_PX, *tail)
    return np.ascontiguousarray(split.swapaxes(1, 2)).reshape(-1, TILE_PX * TILE_PX, *tail)


def untile_image(tiles: NDArray[Any], height: int, width: int) -> NDArray[Any]:
    """The image (H, W, ...) of `tile_image`'s tiles."""
    rows, columns = -(-height // TILE_PX), -(-width // TILE_PX)
    tail = tiles.shape[2:]
    joined = (
        tiles.reshape(rows, columns, TILE_PX, TILE_PX, *tail)
        .swapaxes(1, 2)
        .reshape(rows * TILE_PX, columns * TILE_PX, *tail)
    )
    return joined[:height, :width]


def bundle_points(points: FloatArray, direction: FloatArray) -> NDArray[np.int64]:
    """An order (N,) of points (N, 3) that puts neighbours across ``direction`` together, for parallel rays:
    a Z-order curve."""
    side = np.cross(direction, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, direction)
    x = np.clip((points @ side) * 4 + 32768, 0, 65535).astype(np.uint32)
    y = np.clip((points @ up) * 4 + 32768, 0, 65535).astype(np.uint32)
    return np.argsort(_spread(x) | (_spread(y) << np.uint32(1)), kind="stable")


def _spread(bits: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """16-bit numbers with a zero between each two of their bits."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        bits = (bits | (bits << np.uint32(shift))) & np.uint32(mask)
    return bits
