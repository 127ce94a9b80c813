"""Directions of pixels through a distorted lens, solved once for a camera and cached."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ..geometry import BoolArray, FloatArray
from ..world.drive import CameraModel, RollingShutter

MAX_TABLE_CELLS = 1 << 23
"""Largest number of cells of a table that is cached."""
MAX_TABLES = 8
"""Largest number of cached tables."""
ROWS_PER_CHUNK = 64
_tables: OrderedDict[tuple[CameraModel, int], FloatArray] = OrderedDict()


def directions(model: CameraModel, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return unit directions (..., 3) in the camera's frame through image points u, v (...), pixels.

    Centres of cells of 1, 2, 4, ... pixels are looked up in the camera's table, other points are solved; both give the
    same bits. A point that the lens has no direction for gets one at the edge of the valid domain: see `has_direction`.
    """
    u, v = np.broadcast_arrays(u, v)
    step = _step(u, v)
    if step:
        rows, columns = -(-model.height // step), -(-model.width // step)
        i, j = ((at - step / 2) / step for at in (v, u))
        inside = (
            i.min(initial=0) >= 0 and j.min(initial=0) >= 0 and i.max(initial=0) < rows and j.max(initial=0) < columns
        )
        if inside and rows * columns <= MAX_TABLE_CELLS:
            return _table(model, step)[i.astype(np.int64), j.astype(np.int64)]
    return _solved(model, u, v)


def has_direction(model: CameraModel, u: FloatArray, v: FloatArray) -> BoolArray:
    """Return whether the lens has directions for image points u, v (...), pixels: points outside of its valid domain
    show nothing. (...) bool."""
    if model.is_pinhole:
        return np.ones(np.broadcast(u, v).shape, bool)
    return np.asarray(np.isfinite(model.unproject(u, v)[..., 2]))


@lru_cache(maxsize=16)
def image_mask(model: CameraModel) -> BoolArray | None:
    """Return the pixels (H, W) bool that the lens has directions for; None where it has them for all."""
    if model.is_pinhole:
        return None
    u = np.arange(model.width) + 0.5
    rows = [has_direction(model, u, np.array(v + 0.5)) for v in range(model.height)]
    mask = np.stack(rows)
    mask.flags.writeable = False
    return None if mask.all() else mask


def shows_something(model: CameraModel) -> bool:
    """Return whether the lens has a direction for any pixel; it has none where the image lies beside its valid
    domain."""
    if model.is_pinhole:
        return True
    # the domain lies about the optical axis: if any pixel, it holds the one nearest to it
    u, v = (float(np.clip(c, 0.5, n - 0.5)) for c, n in ((model.cx, model.width), (model.cy, model.height)))
    across, down = np.linspace(0.5, model.width - 0.5, 33), np.linspace(0.5, model.height - 0.5, 33)
    return bool(has_direction(model, np.array(u), np.array(v)) or has_direction(model, across, down[:, None]).any())


@lru_cache(maxsize=64)
def least_pixels_per_rad(model: CameraModel) -> float:
    """Return the smallest number of pixels per radian in an image, along u or v; of a pinhole fx, at the optical
    axis."""
    if model.is_pinhole:
        return model.fx
    v, u = np.meshgrid(np.linspace(0.5, model.height - 0.5, 65), np.linspace(0.5, model.width - 0.5, 65), indexing="ij")
    apart = [
        np.linalg.norm(model.unproject(u + du / 2, v + dv / 2) - model.unproject(u - du / 2, v - dv / 2), axis=-1)
        for du, dv in ((1.0, 0.0), (0.0, 1.0))
    ]
    largest = max((float(x[np.isfinite(x)].max(initial=0.0)) for x in apart), default=0.0)
    # between the places that were looked at it may be coarser still
    return 1 / (1.05 * 2 * math.asin(min(largest / 2, 1.0))) if largest > 0 else model.pixels_per_rad


def _step(u: FloatArray, v: FloatArray) -> int:
    """Return the power of two of whose cells all points u, v (...) are centres; 0 where there is none."""
    if u.size == 0 or not np.isfinite(u.flat[0]) or not 0 < u.flat[0] < 1 << 20:
        return 0
    doubled = 2 * float(u.flat[0])
    if doubled != int(doubled):
        return 0
    step = int(doubled) & -int(doubled)
    for at in (u, v):
        odd = at / step - 0.5
        if not (odd == np.floor(odd)).all():
            return 0
    return step


def _table(model: CameraModel, step: int) -> FloatArray:
    # the shutter does not matter to it
    key = replace(model, shutter=RollingShutter()), step
    table = _tables.get(key)
    if table is None:
        rows, columns = -(-model.height // step), -(-model.width // step)
        u, v = (np.arange(columns) + 0.5) * step, (np.arange(rows) + 0.5) * step
        parts = [
            _solved(model, *np.broadcast_arrays(u, v[i : i + ROWS_PER_CHUNK, None]))
            for i in range(0, rows, ROWS_PER_CHUNK)
        ]
        table = _tables[key] = np.concatenate(parts)
        while len(_tables) > MAX_TABLES:
            _tables.popitem(last=False)
    return table


def _solved(model: CameraModel, u: FloatArray, v: FloatArray) -> FloatArray:
    rays = model.unproject(u, v)
    lost = ~np.isfinite(rays[..., 2])
    if lost.any():
        x, y = (np.nan_to_num((at[lost] - c) / f) for at, c, f in ((u, model.cx, model.fx), (v, model.cy, model.fy)))
        length = np.hypot(x, y)
        safe = np.where(length > 0, length, 1.0)
        # a hair inside of it
        angle = min(model.lens.max_angle_rad, math.pi / 2 if model.is_pinhole else math.pi) * (1 - 1e-9)
        heading = np.where(length > 0, x / safe, 1.0), np.where(length > 0, y / safe, 0.0)
        ring = np.full(len(x), math.cos(angle))
        rays[lost] = np.stack([math.sin(angle) * heading[0], math.sin(angle) * heading[1], ring], -1)
    return rays
