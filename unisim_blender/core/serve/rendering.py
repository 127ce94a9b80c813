"""Renders what requests ask for, and stops where nobody waits any more."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..colour import bytes_from_srgb
from ..output.frame_files import sweep_points
from ..render.captures import render_sweep
from .requests import ImageRequest, SweepRequest
from .turns import Wanted

BAND = 64
"""Rows between two looks at whether an image is still wanted."""


class NotWantedError(Exception):
    """Nobody waits for what is rendered."""


def image_bytes(request: ImageRequest, wanted: Wanted) -> bytes:
    """Render an image as a file. Raises `NotWantedError` soon after ``wanted`` has become false."""
    renderer, states = request.scene.renderer, request.scene.captures.of_drive(request.drive)
    camera = states.camera(request.capture.sensor_id)
    time_s = request.capture.time_s(camera)
    parts = []
    for tile in renderer.progressive(states.state(camera, time_s), camera, time_s, ("rgb",), band=BAND):
        if not wanted():
            raise NotWantedError
        parts.append(bytes_from_srgb(tile.frame.rgb))
    return encoded(np.concatenate(parts), request.format, request.quality)


def encoded(rgb: NDArray[np.uint8], kind: str, quality: float) -> bytes:
    """Return an image (H, W, 3) as a file: "PNG", "JPEG", or "RGB_UINT8_PLANAR", which is (3, H, W) without a header."""
    if kind == "RGB_UINT8_PLANAR":
        return np.ascontiguousarray(np.moveaxis(rgb, -1, 0)).tobytes()
    file = io.BytesIO()
    if kind == "PNG":
        Image.fromarray(rgb).save(file, "PNG", compress_level=1)
    else:
        Image.fromarray(rgb).save(file, "JPEG", quality=round(quality))
    return file.getvalue()


def sweep_of(request: SweepRequest, wanted: Wanted) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Render a sweep: the returns (N, 3) in the LiDAR's frame at the sweep's end, and their intensities (N,) from 0 to 1."""
    if not wanted():
        raise NotWantedError
    scene = request.scene
    sweep = render_sweep(scene.renderer, scene.captures.of_drive(request.drive), request.capture, scene.draw)
    points = sweep_points(sweep)
    return np.stack([points[name] for name in "xyz"], -1).astype(np.float32), points["intensity"].astype(np.float32)
