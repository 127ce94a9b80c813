"""Images as files of other layouts: bytes stay unchanged where the layout has files of their kind."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...data.images import SIGNATURES, encoded_image
from ...data.log import Log
from ...errors import OutputError, in_a_line
from ...lenses import PINHOLE
from ...world.drive import Camera, CameraModel

ROWS_AT_ONCE = 128
COARSEST = 0.5
"""Smallest resolution at the optical axis, relative to that of the recorded image."""


class Rectification:
    """A camera's images through an ideal pinhole of the same size and place, which sees as far to each side as the lens
    does, or at the optical axis has half the lens's resolution.

    Pixels that the lens does not show are black. Raises `OutputError` where the lens does not show its optical axis.
    """

    def __init__(self, camera: Camera) -> None:
        model = camera.model
        slope = float(model.lens.axis_slope)
        if not (np.isfinite(slope) and slope > 0):
            raise OutputError(
                f"{camera.sensor_id}: its lens shows nothing along its axis, so no pinhole sees what it sees"
            )
        self.source = model
        alike = replace(model, fx=model.fx * slope, fy=model.fy * slope, lens=PINHOLE)
        scale = _scale(model, alike)
        self.model = replace(alike, fx=alike.fx * scale, fy=alike.fy * scale)
        self.about = f"{camera.sensor_id}: its images are rectified to a pinhole, {_lost(model, self.model)}"
        self._table: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None

    def image(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a recorded image (H, W, 3) as the pinhole sees it, bilinear."""
        u, v = self._places()
        height, width = rgb.shape[:2]
        out = np.zeros_like(rgb)
        for top in range(0, height, ROWS_AT_ONCE):
            rows = slice(top, top + ROWS_AT_ONCE)
            x, y = u[rows] - 0.5, v[rows] - 0.5
            seen = (x > -0.5) & (x < width - 0.5) & (y > -0.5) & (y < height - 0.5)  # NaN is not
            x, y = np.clip(np.where(seen, x, 0), 0, width - 1), np.clip(np.where(seen, y, 0), 0, height - 1)
            left, upper = x.astype(np.int64), y.astype(np.int64)
            right, lower = np.minimum(left + 1, width - 1), np.minimum(upper + 1, height - 1)
            a, b = (x - left)[..., None], (y - upper)[..., None]
            mixed = (1 - b) * ((1 - a) * rgb[upper, left] + a * rgb[upper, right])
            mixed += b * ((1 - a) * rgb[lower, left] + a * rgb[lower, right])
            out[rows] = np.where(seen[..., None], np.rint(mixed), 0).astype(np.uint8)
        return out

    def _places(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Points u, v (H, W), pixels, of the recorded image for each pixel's ray; computed once."""
        if self._table is None:
            model = self.model
            at = np.meshgrid(np.arange(model.width) + 0.5, np.arange(model.height) + 0.5)
            u, v, _ = self.source.project(model.unproject(*at))
            self._table = u.astype(np.float32), v.astype(np.float32)
        return self._table


def rectification_of(camera: Camera) -> Rectification | None:
    """Return the rectification of a camera's images; None where its lens is an ideal pinhole."""
    return None if camera.model.is_pinhole else Rectification(camera)


def _scale(source: CameraModel, alike: CameraModel) -> float:
    """Return the factor by which a pinhole of the lens's resolution at the axis is coarsened to see as far as the
    image's sides."""
    u = np.array([0.0, source.width, source.cx, source.cx])
    v = np.array([source.cy, source.cy, 0.0, source.height])
    rays, mine = source.unproject(u, v), alike.unproject(u, v)
    shown = np.isfinite(rays[:, 2])
    # beyond 80 degrees a pinhole's image grows without end
    aside = np.hypot(rays[shown, 0], rays[shown, 1]) / np.maximum(rays[shown, 2], np.cos(np.radians(80)))
    reach = np.hypot(mine[shown, 0], mine[shown, 1]) / mine[shown, 2]
    return float(np.clip((reach / aside).min(initial=1.0), COARSEST, 1.0))


def _lost(source: CameraModel, pinhole: CameraModel) -> str:
    """Return the share of the recorded image that lies outside of the pinhole's, in words."""
    u, v = np.meshgrid(np.linspace(0.5, source.width - 0.5, 65), np.linspace(0.5, source.height - 0.5, 65))
    rays = source.unproject(u, v)
    shown = np.isfinite(rays[..., 2])
    x, y, ahead = pinhole.project(np.where(shown[..., None], rays, 0))
    inside = shown & ahead & (x >= 0) & (x <= pinhole.width) & (y >= 0) & (y <= pinhole.height)
    share = 100 * (1 - inside.sum() / max(int(shown.sum()), 1))
    return f"which leaves out {share:.0f} % of what they show" if share >= 1 else "which keeps all that they show"


JPEG_QUALITY = 95


def image_file(log: Log, camera: str, frame: int, kind: str, rectification: Rectification | None = None) -> bytes:
    """Return an image's file of a ``kind``, "jpeg" or "png": the log's own bytes where they are of it and nothing is
    rectified.

    Raises `LogError`, `OutputError`.
    """
    content = encoded_image(log, camera, frame) if rectification is None else log.image(camera, frame)
    if isinstance(content, bytes):
        own_kind = next(form for begin, form in SIGNATURES.items() if content.startswith(begin))
        if own_kind == kind:
            check_size(content, log.drive.cameras[camera].model, f"{log.path}: {camera}'s image of frame {frame}")
            return content
        content = log.image(camera, frame)
    return encode(content if rectification is None else rectification.image(content), kind)


def encoded_for(camera: Camera, rgb: NDArray[np.uint8]) -> bytes:
    """Return an image (H, W, 3), sRGB, of a camera's size as a JPEG file's bytes. Raises `OutputError` for another
    size."""
    model = camera.model
    if rgb.shape != (model.height, model.width, 3) or rgb.dtype != np.uint8:
        raise OutputError(
            f"{camera.sensor_id}: an image of {rgb.shape} {rgb.dtype} is none of {model.width}x{model.height} pixels"
        )
    return encode(rgb, "jpeg")


def encode(rgb: NDArray[np.uint8], kind: str) -> bytes:
    """Return an image (H, W, 3) as a file's bytes."""
    buffer = io.BytesIO()
    if kind == "png":
        Image.fromarray(rgb).save(buffer, "PNG")
    else:
        Image.fromarray(rgb).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return buffer.getvalue()


def path_kind(path: Path | None) -> str:
    """Return "jpeg" or "png" for a file of that suffix, "" for another."""
    return {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}.get("" if path is None else path.suffix.lower(), "")


def check_size(content: bytes, model: CameraModel, where: str) -> None:
    """Raise `OutputError` for an image's file that is broken, or not of a camera's size; ``where`` names it."""
    try:
        with Image.open(io.BytesIO(content)) as image:
            size = image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as fault:
        raise OutputError(f"{where} is broken ({in_a_line(fault)})") from fault
    if size != (model.width, model.height):
        raise OutputError(f"{where} has {size[0]}x{size[1]} pixels, not {model.width}x{model.height}")
