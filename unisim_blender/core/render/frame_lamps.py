"""Rendered images with actors' lamps in the states that edits give them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..sensors.camera import camera_rays
from ..sensors.rays import Rays
from .pending_image import Binding, PendingImage, per_pixel
from .tracer import Maps


def with_lamps(
    pending: PendingImage, bound: Binding, image: NDArray[np.float32], rays: Rays, maps: Maps
) -> NDArray[np.float32]:
    """Return the image (H, W, 3) of rays (h, w) with the lamps of actors where these are seen. All else keeps its bits."""
    camera, time_s, up, image = pending.camera, pending.time_s, pending.tracer.upsample, image.copy()
    instance = maps["instance"].reshape(rays.time_s.shape)
    instance = per_pixel(instance, up, image.shape)
    for number, actor in pending.lit.items():
        y, x = np.nonzero(instance == number)
        if not len(y):
            continue
        # a cell has one ray, its pixels each have one of their own: where a ray goes through tells which pixels they are
        cell = y[0] // up, x[0] // up
        pose = camera.world_from_camera.at(rays.time_s[cell])
        corner = np.stack(camera.model.project(rays.directions[cell] @ pose[:3, :3])[:2]) - up / 2
        left, top = np.rint(corner) - up * np.array(cell)[::-1]
        seen = camera_rays(camera, time_s, left + x + 0.5, top + y + 0.5)
        poses, scale = actor.world_from_actor.at(seen.time_s), np.array(actor.scale)
        origins = np.einsum("nij,ni->nj", poses[:, :3, :3], seen.origins - poses[:, :3, 3]) / scale
        directions = np.einsum("nij,ni->nj", poses[:, :3, :3], seen.directions) / scale
        for lamp in actor.lamps:
            (state,) = lamp.at(time_s).shown
            for patch in lamp.patches:
                colours, share = patch.drawn(origins, directions, actor.appearance_size_m, int(state))
                some = np.flatnonzero(share[:, 0] > 0)
                colours = bound.exposed(colours[some], camera.sensor_id, time_s)
                before = image[y[some], x[some]]
                image[y[some], x[some]] = before + share[some] * (colours - before)
    return image
