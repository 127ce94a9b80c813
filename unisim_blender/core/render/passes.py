"""What an image holds beside its colours: depth, normal, instance, opacity, and what nothing recorded supports."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..sensors.frames import CameraFrame
from .tracer import Maps


def fill_passes(
    out: CameraFrame, maps: Maps, along: FloatArray | None, shape: tuple[int, ...], up: int, inner: tuple[slice, slice]
) -> None:
    """Put passes of rays, one a cell of ``shape``, into a frame; a cell is ``up`` x ``up`` pixels; ``inner`` of them
    count. ``along`` (h, w), of each ray's cell, is how far a metre of it goes along the optical axis:
    for depths alone."""

    def full(values: NDArray[Any], kind: type[np.generic]) -> NDArray[Any]:
        grid = values.reshape(*shape, *values.shape[1:])
        if up > 1:
            grid = np.repeat(np.repeat(grid, up, 0), up, 1)
        return np.ascontiguousarray(grid[inner], kind)

    if "depth" in maps:
        assert along is not None
        out.depth_m = full(maps["depth"], np.float32)
        out.z_depth_m = (out.depth_m * full(along.reshape(-1), np.float64)).astype(np.float32)
    if "normal" in maps:
        out.normal = full(maps["normal"], np.float32)
    if "instance" in maps:
        out.instance = full(maps["instance"], np.int32)
    if "opacity" in maps:
        out.opacity = full(maps["opacity"], np.float32)
    if "unsupported" in maps:
        out.unsupported = full(maps["unsupported"], np.bool_)
