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
    return _row_times(camera, camera.time_s[frame], v)


def _row_times(camera: Camera, time_s: float | FloatArray, v: FloatArray) -> FloatArray:
    shutter = camera.model.shutter
    return time_s + shutter.duration_s * (v / camera.model.height - shutter.reference)


def camera_rays(camera: Camera, frame: int, u: FloatArray, v: FloatArray) -> Rays:
    """Rays through image points u, v (...), given in pixels; every ray leaves at its row's own time."""
    if camera.model.shutter.duration_s == 0.0:
        pose = camera.world_from_camera.at(camera.time_s[frame])
        local = pixel_directions(camera.model, u, v)
        directions = rotate_vectors(pose, local.reshape(-1, 3)).reshape(local.shape)
        return Rays(np.broadcast_to(pose[:3, 3], local.shape).copy(), directions, row_times(camera, frame, v))
    return rays_at_times(camera, camera.time_s[frame], u, v)


def rays_at_times(camera: Camera, time_s: float | FloatArray, u: FloatArray, v: FloatArray) -> Rays:
    """Rays through image points u, v (...), in pixels, of an image that was taken at a time, or of one each (...)."""
    time = _row_times(camera, time_s, v)
    # a row's rays leave together: one pose for all of them
    moments, which = np.unique(time, return_inverse=True)
    pose = camera.world_from_camera.at(moments)
    which = which.reshape(v.shape)
    directions = np.einsum("...ij,...j->...i", pose[:, :3, :3][which], pixel_directions(camera.model, u, v))
    return Rays(pose[:, :3, 3][which], directions, time)


def pixel_grid(model: CameraModel, step: int = 1) -> tuple[FloatArray, FloatArray]:
    """Centres u, v (ceil(H / step), ceil(W / step)) of the cells of step x step pixels, in pixels."""
    rows, columns = -(-model.height // step), -(-model.width // step)
    v, u = np.meshgrid((np.arange(rows) + 0.5) * step, (np.arange(columns) + 0.5) * step, indexing="ij")
    return u, v
