"""Rays in coherent bundles, each with a frustum that holds all its rays, to skip what they cannot hit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import BoolArray, FloatArray

TILE = 16
"""Rays of an image are bundled by tiles of TILE x TILE; a bundle holds TILE ** 2 rays."""

_MARGIN_M = 2e-3  # the frusta are compared in float32


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
    planes[..., 3] = np.einsum("bki,bpi->bkp", origins, planes[..., :3]).max(1) + _MARGIN_M
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
    rows = np.minimum(np.arange(-(-height // TILE) * TILE), height - 1)
    columns = np.minimum(np.arange(-(-width // TILE) * TILE), width - 1)
    padded = values[rows][:, columns]
    tail = values.shape[2:]
    split = padded.reshape(len(rows) // TILE, TILE, len(columns) // TILE, TILE, *tail)
    return np.ascontiguousarray(split.swapaxes(1, 2)).reshape(-1, TILE * TILE, *tail)


def untile_image(tiles: NDArray[Any], height: int, width: int) -> NDArray[Any]:
    """The image (H, W, ...) of `tile_image`'s tiles."""
    rows, columns = -(-height // TILE), -(-width // TILE)
    tail = tiles.shape[2:]
    joined = tiles.reshape(rows, columns, TILE, TILE, *tail).swapaxes(1, 2).reshape(rows * TILE, columns * TILE, *tail)
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
