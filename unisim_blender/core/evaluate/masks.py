"""Which of a camera's pixels look through actors' boxes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..drive import Actor, Camera
from ..geometry import BoolArray, invert_pose
from ..sensors.camera import camera_rays, pixel_grid


def actor_mask(camera: Camera, frame: int, actors: Iterable[Actor]) -> BoolArray:
    """Pixels (H, W) whose ray meets the box of one of the actors where it is at the ray's own time, occluded or not."""
    u, v = pixel_grid(camera.model)
    rays = camera_rays(camera, frame, u, v)
    times = rays.time_s[:, 0]
    mask = np.zeros(u.shape, bool)
    for actor in actors:
        rows = np.flatnonzero(actor.present(times))
        if not len(rows):
            continue
        # an image row has one time, so one pose a row serves all its rays
        box_from_world = invert_pose(actor.world_from_actor.at(times[rows]))
        rotation = box_from_world[:, None, :3, :3]
        origins = (rotation @ rays.origins[rows][..., None])[..., 0] + box_from_world[:, None, :3, 3]
        directions = (rotation @ rays.directions[rows][..., None])[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            half = np.asarray(actor.size_m) / 2
            a, b = (-half - origins) / directions, (half - origins) / directions
        near, far = np.fmin(a, b).max(-1), np.fmax(a, b).min(-1)
        mask[rows] |= (near <= far) & (far > 0)
    return mask
