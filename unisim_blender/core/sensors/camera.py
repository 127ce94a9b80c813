"""Camera rays: one for each cell of a pixel grid, at its row's own time, from where the camera was then."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, rotate_vectors
from ..world.drive import Camera, CameraModel
from .rays import Rays

MOST_ROWS = 1 << 14
"""Values that lie farther apart than this, and than there are of them, are sorted rather than counted."""


def pixel_directions(model: CameraModel, u: FloatArray, v: FloatArray) -> FloatArray:
    """Unit directions (..., 3) in the camera's frame through image points (u, v) (...), in pixels from the
    top left corner."""
    x, y = (u - model.cx) / model.fx, (v - model.cy) / model.fy
    length = np.sqrt(x * x + (y * y + 1))
    d = np.empty((*length.shape, 3))
    d[..., 0], d[..., 1], d[..., 2] = x / length, y / length, 1 / length
    return d


def row_times(camera: Camera, time_s: float | FloatArray, v: FloatArray) -> FloatArray:
    """Exposure times (...) of image rows v (...), in pixels, of an image taken at ``time_s``, or of one each (...)."""
    shutter = camera.model.shutter
    return time_s + shutter.duration_s * (v / camera.model.height - shutter.reference)


def camera_rays(camera: Camera, time_s: float, u: FloatArray, v: FloatArray) -> Rays:
    """Rays through points u, v (...), in pixels, of an image taken at ``time_s``; every ray leaves at
    its row's own time."""
    if camera.model.shutter.duration_s == 0.0:
        pose = camera.world_from_camera.at(time_s)
        local = pixel_directions(camera.model, u, v)
        directions = rotate_vectors(pose, local.reshape(-1, 3)).reshape(local.shape)
        return Rays(np.broadcast_to(pose[:3, 3], local.shape).copy(), directions, row_times(camera, time_s, v))
    return rays_at_times(camera, time_s, u, v)


def rays_at_times(camera: Camera, time_s: float | FloatArray, u: FloatArray, v: FloatArray) -> Rays:
    """Rays through image points u, v (...), in pixels, of an image that was taken at a time, or of one each (...)."""
    # a row's rays leave together: one pose for all of them
    if np.ndim(time_s) == 0:
        rows, which = distinct(v)
        moments = row_times(camera, time_s, rows)
    else:
        moments, which = distinct(row_times(camera, time_s, v))
    pose = camera.world_from_camera.at(moments)
    local = pixel_directions(camera.model, u, v)
    directions = np.empty_like(local)
    for i in range(3):
        # sums by component: nine numbers a ray are never gathered in one array
        part = pose[:, i, 0][which] * local[..., 0]
        for j in (1, 2):
            part += pose[:, i, j][which] * local[..., j]
        directions[..., i] = part
    return Rays(pose[:, :3, 3][which], directions, moments[which])


def along_axis(camera: Camera, time_s: float, u: FloatArray, v: FloatArray) -> FloatArray:
    """How far along the optical axis, as it is at ``time_s``, a metre of each ray goes: `camera_rays`' directions times
    that axis. Image points u (1, W), v (H, 1) in pixels; the answer is (H, W)."""
    model = camera.model
    axis = camera.world_from_camera.at(time_s)[:3, 2]
    moments = row_times(camera, time_s, v[:, 0])
    turned = camera.world_from_camera.at(moments)[:, :3, :3].swapaxes(1, 2) @ axis
    x, y = (u - model.cx) / model.fx, (v - model.cy) / model.fy
    along: FloatArray = x * turned[:, :1] + (y * turned[:, 1:2] + turned[:, 2:])
    along /= np.sqrt(x * x + (y * y + 1))
    return along


def distinct(values: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """The distinct ones of values (...), rising, and the number of its own for each (...): `np.unique`, without sorting
    where they are whole steps apart, like rows of pixels."""
    flat = values.reshape(-1)
    if len(flat):
        first = float(flat.min())
        if float(flat.max()) - first < min(len(flat) + MOST_ROWS, 1 << 30):
            steps = (flat - first).astype(np.int32)
            if np.array_equal(first + steps, flat):
                here = np.zeros(int(steps.max()) + 1, bool)
                here[steps] = True
                which = (np.cumsum(here) - 1)[steps]
                return first + np.flatnonzero(here), which.reshape(values.shape)
    found, which = np.unique(flat, return_inverse=True)
    return found, which.reshape(values.shape)


def pixel_grid(model: CameraModel, step: int = 1) -> tuple[FloatArray, FloatArray]:
    """Centres u, v (ceil(H / step), ceil(W / step)) of the cells of step x step pixels, in pixels."""
    rows, columns = -(-model.height // step), -(-model.width // step)
    v, u = np.meshgrid((np.arange(rows) + 0.5) * step, (np.arange(columns) + 0.5) * step, indexing="ij")
    return u, v
