"""Rendered images with actors' lamps in the states that edits give them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..sensors.rays import Rays
from .pending_image import Binding, PendingImage
from .tracer import Maps


def with_lamps(
    pending: PendingImage, bound: Binding, image: NDArray[np.float32], rays: Rays, maps: Maps
) -> NDArray[np.float32]:
    """Return the image (H, W, 3) of rays (h, w) with the lamps of actors where these are seen. All else keeps its bits."""
    up, image = pending.tracer.upsample, image.copy()
    instance = maps["instance"].reshape(rays.time_s.shape)
    instance = np.repeat(np.repeat(instance, up, 0), up, 1)[: image.shape[0], : image.shape[1]]
    for number, actor in pending.lit.items():
        y, x = np.nonzero(instance == number)
        origins, directions, times = (
            _between(values, y, x, up) for values in (rays.origins, rays.directions, rays.time_s)
        )
        poses, scale = actor.world_from_actor.at(times), np.array(actor.scale)
        origins = np.einsum("nij,ni->nj", poses[:, :3, :3], origins - poses[:, :3, 3]) / scale
        directions = np.einsum("nij,ni->nj", poses[:, :3, :3], directions) / scale
        for lamp in actor.lamps:
            (state,) = lamp.at(pending.time_s).shown
            for patch in lamp.patches:
                colours, share = patch.drawn(origins, directions, actor.appearance_size_m, int(state))
                some = np.flatnonzero(share[:, 0] > 0)
                colours = bound.exposed(colours[some], pending.camera.sensor_id, pending.time_s)
                before = image[y[some], x[some]]
                image[y[some], x[some]] = before + share[some] * (colours - before)
    return image


def _between(values: FloatArray, y: NDArray[np.int64], x: NDArray[np.int64], up: int) -> FloatArray:
    """Return values (N, ...) at pixels y, x (N,) from those at the middles of cells (h, w, ...), ``up`` pixels wide. They depend
    on the cells beside a pixel alone, to the bit."""
    if up == 1:
        return values[y, x]
    low, high, part = [], [], []
    for pixel, cells in ((y, values.shape[0]), (x, values.shape[1])):
        cell, rest = np.divmod(2 * pixel + 1 - up, 2 * up)
        low.append(np.clip(cell, 0, max(cells - 2, 0)))
        high.append(np.minimum(low[-1] + 1, cells - 1))
        share = rest / (2 * up) + (cell - low[-1])  # straight on beyond the cells at the edges
        part.append(share.reshape(-1, *(1,) * (values.ndim - 2)))
    (i, j), (k, m), (a, b) = low, high, part
    top, bottom = ((1 - b) * values[row, j] + b * values[row, m] for row in (i, k))
    return np.asarray((1 - a) * top + a * bottom)
