"""Which of a camera's pixels look through actors' boxes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..geometry import BoolArray, intersect_boxes, invert_pose
from ..sensors.camera import camera_rays, pixel_grid
from ..sensors.rays import Rays
from ..sensors.unprojection import image_mask
from ..world.drive import Actor, Camera


def actor_mask(camera: Camera, frame: int, actors: Iterable[Actor]) -> BoolArray:
    """Pixels (H, W) whose ray hits the box of one of the actors where it is at the ray's own time, occluded or not."""
    u, v = pixel_grid(camera.model)
    rays = camera_rays(camera, camera.time_s[frame], u, v)
    if camera.model.shutter.axis == "columns":
        # below, what comes first are the lines that are exposed together
        rays = Rays(rays.origins.swapaxes(0, 1), rays.directions.swapaxes(0, 1), rays.time_s.T)
    times = rays.time_s[:, 0]
    mask = np.zeros(rays.time_s.shape, bool)
    for actor in actors:
        rows = np.flatnonzero(actor.present(times))
        if not len(rows):
            continue
        # a line has one time, so one pose a line serves all its rays; few of them pass through the sphere round a box
        to = actor.world_from_actor.positions_at(times[rows]) - rays.origins[rows, 0]
        radius = float(np.linalg.norm(actor.size_m)) / 2 + 1e-6
        along = (rays.directions[rows] @ to[:, :, None])[..., 0]
        away = (to**2).sum(1, keepdims=True) - radius**2
        row, column = np.nonzero((away <= 0) | ((along > 0) & (along**2 >= away)))
        box_from_world = invert_pose(actor.world_from_actor.at(times[rows]))[row, None]
        place = rows[row], column
        near, far = intersect_boxes(
            rays.origins[place], rays.directions[place], box_from_world, np.asarray(actor.size_m)[None]
        )
        mask[place] |= ((near <= far) & (far > 0))[:, 0]
    if camera.model.shutter.axis == "columns":
        mask = mask.T
    shown = image_mask(camera.model)
    return mask if shown is None else mask & shown
