"""Camera models as lenses that a Blender camera has, and back; edges of boxes as a lens that bends lines shows them.

A Blender camera has one focal length, so a model with two is not exactly one. It is looked through along -z.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...core.geometry import FloatArray
from ...core.world.drive import CameraModel

SENSOR_MM = 36.0
"""Width of a sensor that stands for a camera model."""
WIDEST_RAD = np.radians(75.0)
"""A frustum shows a wide lens up to this angle from its axis."""
BORDER_STEPS = 65
PLAIN_PX = 960, 540
"""Width and height of a camera without a model, where no render says them."""


@dataclass(frozen=True)
class BlenderLens:
    """A camera's focal length and its sensor's size in millimetres, the shifts of its optical axis as shares of the
    longer edge, and ``fit``: which edge the sensor's size is of, HORIZONTAL, VERTICAL, or AUTO for the longer one."""

    focal_mm: float
    shift_x: float
    shift_y: float
    width_mm: float = SENSOR_MM
    height_mm: float = SENSOR_MM
    fit: str = "HORIZONTAL"


def lens_of(model: CameraModel) -> BlenderLens:
    """Return the lens of a camera model; its focal length is the horizontal one. Of one that bends lines, the lens of
    `undistorted`."""
    model = undistorted(model)
    return BlenderLens(
        model.fx / model.width * SENSOR_MM,
        (model.width / 2 - model.cx) / model.width,
        (model.cy - model.height / 2) / model.width,
    )


def undistorted(model: CameraModel) -> CameraModel:
    """Return the pinhole whose frustum reaches as far to the left, right, top and bottom as the image does along the
    rows and columns through the principal point, but at most `WIDEST_RAD` from the optical axis; a pinhole itself."""
    if model.is_pinhole:
        return model
    along_u = (
        np.linspace(0, model.width, BORDER_STEPS),
        np.full(BORDER_STEPS, min(max(model.cy, 0.0), float(model.height))),
    )
    along_v = (
        np.full(BORDER_STEPS, min(max(model.cx, 0.0), float(model.width))),
        np.linspace(0, model.height, BORDER_STEPS),
    )
    left, right = _reach(model.unproject(*along_u), 0)
    top, bottom = _reach(model.unproject(*along_v), 1)
    fx, fy = model.width / (right - left), model.height / (bottom - top)
    return CameraModel(model.width, model.height, fx, fy, -left * fx, -top * fy, model.shutter)


def degrees_across(model: CameraModel) -> float:
    """Return the angle between the left and the right end of an image, along its middle row, as far as its lens shows
    it."""
    if model.is_pinhole:
        return float(np.degrees(2 * np.arctan(model.width / 2 / model.fx)))
    rays = model.unproject(np.linspace(0, model.width, BORDER_STEPS), np.full(BORDER_STEPS, model.height / 2))
    angle = np.degrees(np.arctan2(rays[:, 0], rays[:, 2]))
    return float(np.nanmax(angle) - np.nanmin(angle)) if np.isfinite(angle).any() else 0.0


def _reach(rays: FloatArray, axis: int) -> tuple[float, float]:
    """From which to which slope rays (N, 3) reach along an axis; those that the lens does not have are NaN."""
    angle = np.arctan2(rays[:, axis], rays[:, 2])
    angle = np.clip(angle[np.isfinite(angle)], -WIDEST_RAD, WIDEST_RAD)
    low, high = float(np.tan(angle.min(initial=0.0))), float(np.tan(angle.max(initial=0.0)))
    return (low, high) if high - low > 1e-3 else (low - 0.5, high + 0.5)


def model_of_lens(
    lens: BlenderLens, size: tuple[int, int] | None = None, exact: CameraModel | None = None
) -> CameraModel:
    """Return the camera model of a lens at a size (width, height) in pixels.

    ``exact`` is the model that the lens was made for before it was changed: size, shutter and the ratio of
    focal lengths stay.
    """
    width, height = (exact.width, exact.height) if exact is not None else size or PLAIN_PX
    along = max(width, height) if lens.fit == "AUTO" else width if lens.fit == "HORIZONTAL" else height
    focal = lens.focal_mm / (lens.height_mm if lens.fit == "VERTICAL" else lens.width_mm) * along
    plain = CameraModel(
        width, height, focal, focal, width / 2 - lens.shift_x * along, height / 2 + lens.shift_y * along
    )
    if exact is None:
        return plain
    if not exact.is_pinhole:
        # what the frustum was zoomed and shifted by, the image is
        shown = undistorted(exact)
        zoom = focal / shown.fx
        cx, cy = exact.cx + plain.cx - shown.cx, exact.cy + plain.cy - shown.cy
        return replace(exact, fx=exact.fx * zoom, fy=exact.fy * zoom, cx=cx, cy=cy)
    return replace(plain, fy=focal * exact.fy / exact.fx, shutter=exact.shutter)


def corners(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the corners (8, 3) of a box between two of them (3,): bit k of a corner's number says that its axis k is
    high."""
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
    return np.where(bits == 1, high, low)
