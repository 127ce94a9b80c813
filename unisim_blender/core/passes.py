"""What a picture holds beside its colours: depth, normal, instance, opacity, and what nothing recorded supports."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .frames import CameraFrame
from .sensors.rays import Rays
from .tracer import Maps


def fill_passes(
    out: CameraFrame, maps: Maps, rays: Rays | None, shape: tuple[int, ...], up: int, inner: tuple[slice, slice]
) -> None:
    """Put passes of rays, one a cell of ``shape``, into a frame; a cell is ``up`` x ``up`` pixels; ``inner`` of them count. The
    rays are needed for depths alone."""

    def full(values: NDArray[Any]) -> NDArray[Any]:
        grid = values.reshape(*shape, *values.shape[1:])
        return np.repeat(np.repeat(grid, up, 0), up, 1)[inner]

    if "depth" in maps:
        assert rays is not None
        out.depth_m = full(maps["depth"]).astype(np.float32)
        axis = out.world_from_camera[:3, 2]
        along = full((rays.directions @ axis).reshape(-1))
        out.z_depth_m = (out.depth_m * along).astype(np.float32)
    if "normal" in maps:
        out.normal = full(maps["normal"]).astype(np.float32)
    if "instance" in maps:
        out.instance = full(maps["instance"]).astype(np.int32)
    if "opacity" in maps:
        out.opacity = full(maps["opacity"]).astype(np.float32)
    if "support" in maps:
        out.unsupported = full(maps["support"]).astype(np.bool_)
