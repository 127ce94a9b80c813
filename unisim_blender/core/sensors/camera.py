"""Camera rays: one for each cell of a pixel grid, at its row's or column's own time, from where the camera was then."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, rotate_vectors
from ..world.drive import Camera, CameraModel
from . import unprojection
from .rays import Rays

MAX_COUNTED_SPAN = 1 << 14
"""Span of values above which they are sorted rather than counted, unless there are more values than the span."""


def pixel_directions(model: CameraModel, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return unit directions (..., 3) in the camera's frame through image points u, v (...), pixels from the top left
    corner."""
    if not model.is_pinhole:
        return unprojection.directions(model, u, v)
    x, y = (u - model.cx) / model.fx, (v - model.cy) / model.fy
    length = np.sqrt(x * x + (y * y + 1))
    d = np.empty((*length.shape, 3))
    d[..., 0], d[..., 1], d[..., 2] = x / length, y / length, 1 / length
    return d


def lines(model: CameraModel, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the coordinate of image points u, v (...) that determines when they are exposed: the row, or the column
    where the shutter reads columns."""
    return u if model.shutter.axis == "columns" else v


def line_count(model: CameraModel) -> int:
    """Return the number of lines that the shutter reads."""
    return model.width if model.shutter.axis == "columns" else model.height


def line_times(camera: Camera, time_s: float | FloatArray, line: FloatArray) -> FloatArray:
    """Return exposure times (...), seconds, of `lines` (...), pixels, of an image taken at ``time_s``, or of one each
    (...)."""
    shutter = camera.model.shutter
    duration_s = shutter.duration_s if camera.readouts is None else shutter.duration_s * camera.readouts.at(time_s)
    return time_s + duration_s * (line / line_count(camera.model) - shutter.reference)


def camera_rays(camera: Camera, time_s: float, u: FloatArray, v: FloatArray) -> Rays:
    """Return rays (...), world frame, through points u, v (...), pixels, of an image taken at ``time_s``; each ray
    leaves at its line's own time."""
    if camera.model.shutter.duration_s == 0.0:
        pose = camera.world_from_camera.at(time_s)
        local = pixel_directions(camera.model, u, v)
        directions = rotate_vectors(pose, local.reshape(-1, 3)).reshape(local.shape)
        times = line_times(camera, time_s, lines(camera.model, u, v))
        return Rays(np.broadcast_to(pose[:3, 3], local.shape).copy(), directions, times)
    return rays_at_times(camera, time_s, u, v)


def rays_at_times(camera: Camera, time_s: float | FloatArray, u: FloatArray, v: FloatArray) -> Rays:
    """Return rays (...), world frame, through points u, v (...), pixels, of an image taken at ``time_s``, or of one
    each (...)."""
    # a line's rays leave together: one pose for all of them
    line = lines(camera.model, u, v)
    if np.ndim(time_s) == 0:
        some, which = distinct(line)
        moments = line_times(camera, time_s, some)
    else:
        moments, which = distinct(line_times(camera, time_s, line))
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
    """Return the component (H, W) of the directions of `camera_rays` along the optical axis at ``time_s``, for image
    points u (1, W), v (H, 1), pixels."""
    model = camera.model
    axis = camera.world_from_camera.at(time_s)[:3, 2]
    line = lines(model, u[0], v[:, 0])
    turned = camera.world_from_camera.at(line_times(camera, time_s, line))[:, :3, :3].swapaxes(1, 2) @ axis
    if not model.is_pinhole or model.shutter.axis == "columns":
        turned = turned[None] if model.shutter.axis == "columns" else turned[:, None]
        return np.asarray((pixel_directions(model, u, v) * turned).sum(-1))
    x, y = (u - model.cx) / model.fx, (v - model.cy) / model.fy
    along: FloatArray = x * turned[:, :1] + (y * turned[:, 1:2] + turned[:, 2:])
    along /= np.sqrt(x * x + (y * y + 1))
    return along


def distinct(values: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the distinct values, ascending, and the index (...) of each value among them: `np.unique`, without sorting
    where they are whole steps apart, as rows of pixels are."""
    flat = values.reshape(-1)
    if len(flat):
        first = float(flat.min())
        if float(flat.max()) - first < min(len(flat) + MAX_COUNTED_SPAN, 1 << 30):
            steps = (flat - first).astype(np.int32)
            if np.array_equal(first + steps, flat):
                here = np.zeros(int(steps.max()) + 1, bool)
                here[steps] = True
                which = (np.cumsum(here) - 1)[steps]
                return first + np.flatnonzero(here), which.reshape(values.shape)
    distinct, which = np.unique(flat, return_inverse=True)
    return distinct, which.reshape(values.shape)


def pixel_grid(model: CameraModel, step: int = 1) -> tuple[FloatArray, FloatArray]:
    """Return the centres u, v (ceil(H / step), ceil(W / step)), pixels, of cells of step x step pixels."""
    rows, columns = -(-model.height // step), -(-model.width // step)
    v, u = np.meshgrid((np.arange(rows) + 0.5) * step, (np.arange(columns) + 0.5) * step, indexing="ij")
    return u, v
