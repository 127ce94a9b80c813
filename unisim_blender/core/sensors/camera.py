"""Camera rays: one for each cell of a pixel grid, at its row's own time, from where the camera was then."""

from __future__ import annotations

import numpy as np

from ..drive import Camera, CameraModel
from ..geometry import FloatArray, rotate_vectors
from .rays import Rays


def pixel_directions(model: CameraModel, u: FloatArray, v: FloatArray) -> FloatArray:
    """Unit directions (..., 3) in the camera's frame through image points (u, v) (...), in pixels from the top left corner."""
    d = np.stack([(u - model.cx) / model.fx, (v - model.cy) / model.fy, np.ones_like(u)], -1)
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def row_times(camera: Camera, frame: int, v: FloatArray) -> FloatArray:
    """Exposure times (...) of image rows v (...), in pixels."""
    shutter = camera.model.shutter
    return camera.time_s[frame] + shutter.duration_s * (v / camera.model.height - shutter.reference)


def camera_rays(camera: Camera, frame: int, u: FloatArray, v: FloatArray) -> Rays:
    """Rays through image points u, v (...), given in pixels; every ray leaves at its row's own time."""
    time = row_times(camera, frame, v)
    if camera.model.shutter.duration_s == 0.0:
        pose = camera.world_from_camera.at(camera.time_s[frame])
        local = pixel_directions(camera.model, u, v)
        directions = rotate_vectors(pose, local.reshape(-1, 3)).reshape(local.shape)
        return Rays(np.broadcast_to(pose[:3, 3], local.shape).copy(), directions, time)
    # a row's rays leave together: one pose for all of them
    rows, which = np.unique(v, return_inverse=True)
    pose = camera.world_from_camera.at(row_times(camera, frame, rows))
    which = which.reshape(v.shape)
    directions = np.einsum("...ij,...j->...i", pose[:, :3, :3][which], pixel_directions(camera.model, u, v))
    return Rays(pose[:, :3, 3][which], directions, time)


def pixel_grid(model: CameraModel, step: int = 1) -> tuple[FloatArray, FloatArray]:
    """Centres u, v (ceil(H / step), ceil(W / step)) of the cells of step x step pixels, in pixels."""
    rows, columns = -(-model.height // step), -(-model.width // step)
    v, u = np.meshgrid((np.arange(rows) + 0.5) * step, (np.arange(columns) + 0.5) * step, indexing="ij")
    return u, v
