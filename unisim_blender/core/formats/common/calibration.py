"""Camera models in OpenCV's and ROS's words."""

from __future__ import annotations

from dataclasses import dataclass

from ...lenses.opencv_fisheye import OpenCVFisheye
from ...lenses.opencv_pinhole import OpenCVPinhole
from ...world.drive import CameraModel

PLUMB_BOB, RATIONAL, FISHEYE = "plumb_bob", "rational_polynomial", "equidistant"
"""ROS's names of OpenCV's distortions; Foxglove calls the last one kannala_brandt."""


@dataclass(frozen=True)
class OpenCVCalibration:
    """``matrix``: K, row by row, with pixel centres at whole numbers, as OpenCV and ROS have them. ``coefficients`` are in the
    order of ``distortion``; other lenses have their own name there, and none."""

    matrix: tuple[float, ...]
    distortion: str
    coefficients: tuple[float, ...]

    @property
    def projection(self) -> tuple[float, ...]:
        """P, row by row: K and a column of zeros."""
        k = self.matrix
        return (*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0)


def calibration_of(model: CameraModel) -> OpenCVCalibration:
    """Return a camera's calibration."""
    # here a pixel's centre is at a half
    matrix = (model.fx, 0.0, model.cx - 0.5, 0.0, model.fy, model.cy - 0.5, 0.0, 0.0, 1.0)
    lens = model.lens
    if model.is_pinhole:
        return OpenCVCalibration(matrix, PLUMB_BOB, (0.0,) * 5)
    if isinstance(lens, OpenCVFisheye):
        return OpenCVCalibration(matrix, FISHEYE, (lens.k1, lens.k2, lens.k3, lens.k4))
    if isinstance(lens, OpenCVPinhole) and not any((lens.s1, lens.s2, lens.s3, lens.s4)):
        first = (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3)
        if any((lens.k4, lens.k5, lens.k6)):
            return OpenCVCalibration(matrix, RATIONAL, (*first, lens.k4, lens.k5, lens.k6))
        return OpenCVCalibration(matrix, PLUMB_BOB, first)
    return OpenCVCalibration(matrix, lens.TYPE, ())
