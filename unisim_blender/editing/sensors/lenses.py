"""Camera models as lenses that a Blender camera has, and back.

A Blender camera has one focal length, so a model with two is not exactly one. It is looked through along -z.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...core.world.drive import CameraModel

SENSOR_MM = 36.0
"""Width of a sensor that stands for a camera model."""
PLAIN_PX = 960, 540
"""Width and height of a camera without a model, where no render says them."""


@dataclass(frozen=True)
class Lens:
    """A camera's focal length and its sensor's size in millimetres, the shifts of its optical axis as shares of the
    longer edge, and ``fit``: which edge the sensor's size is of, HORIZONTAL, VERTICAL, or AUTO for the longer one."""

    focal_mm: float
    shift_x: float
    shift_y: float
    width_mm: float = SENSOR_MM
    height_mm: float = SENSOR_MM
    fit: str = "HORIZONTAL"


def lens_of(model: CameraModel) -> Lens:
    """Return the lens of a camera model; its focal length is the horizontal one."""
    return Lens(
        model.fx / model.width * SENSOR_MM,
        (model.width / 2 - model.cx) / model.width,
        (model.cy - model.height / 2) / model.width,
    )


def model_of_lens(lens: Lens, size: tuple[int, int] | None = None, exact: CameraModel | None = None) -> CameraModel:
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
    return plain if exact is None else replace(plain, fy=focal * exact.fy / exact.fx, shutter=exact.shutter)
