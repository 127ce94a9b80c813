"""NCore's camera parameters and ours. NCore's are float32: rays differ by less than 1e-6 rad.

Both count pixels from the corner of the first, save NCore's f-theta, whose principal point counts from the first pixel's centre.

Line i of H is exposed at ``start + (end - start) * i / (H - 1)``, counted from the side that is read first; a global shutter's
image as a whole at ``start`` (NCore's `image_points_relative_frame_times`). Ours count from a line's edge, middle i + 0.5.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError, OutputError
from ...geometry import FloatArray
from ...lenses import PINHOLE
from ...lenses.f_theta import FTheta
from ...lenses.lens import Lens, LensError
from ...lenses.opencv_fisheye import OpenCVFisheye
from ...lenses.opencv_pinhole import OpenCVPinhole
from ...lenses.registry import Pinhole
from ...world.drive import Camera, CameraModel, Readouts, RollingShutter

TYPES = {
    ("rows", False): "ROLLING_TOP_TO_BOTTOM",
    ("rows", True): "ROLLING_BOTTOM_TO_TOP",
    ("columns", False): "ROLLING_LEFT_TO_RIGHT",
    ("columns", True): "ROLLING_RIGHT_TO_LEFT",
}
ROUNDED_S = 2.5e-6
"""Start and end are whole microseconds: spans that differ by no more are the same."""
GLOBAL = "GLOBAL"
"""Names of NCore's `ShutterType`; True where the last line is read first."""


def shutter_type(shutter: RollingShutter) -> str:
    """Return the name of NCore's type of a shutter."""
    return GLOBAL if shutter.duration_s == 0 else TYPES[shutter.axis, shutter.duration_s < 0]


def exposed(camera: Camera, time_s: float) -> tuple[float, float]:
    """Return when the first and the last line to be read of an image stamped ``time_s`` are exposed, by their middles."""
    model = camera.model_at(time_s)
    shutter = model.shutter
    half = 0.5 / _lines(model.width, model.height, shutter.axis)
    ends = [time_s + shutter.duration_s * (at - shutter.reference) for at in (half, 1 - half)]
    return min(ends), max(ends)


def shutter_of(name: str, span_s: float, width: int, height: int) -> RollingShutter:
    """Return the shutter of an NCore type whose last line is exposed ``span_s`` after its first. Images are stamped with the
    middle between both, a global shutter's with their start."""
    known = {value: key for key, value in TYPES.items()}
    if name not in known or span_s == 0:
        return RollingShutter()
    axis, reverse = known[name]
    lines = _lines(width, height, axis)
    duration = span_s * lines / max(lines - 1, 1)
    return RollingShutter(-duration if reverse else duration, 0.5, axis)


def readouts_of(name: str, stamps_s: FloatArray, spans_s: FloatArray, span_s: float) -> Readouts | None:
    """Return how images stamped ``stamps_s`` (K,) differ whose last lines are exposed ``spans_s`` (K,) after their first, in
    place of ``span_s``; None where that is rounding."""
    if name == GLOBAL or len(spans_s) == 0 or (spans_s <= 0).any() or np.ptp(spans_s) <= ROUNDED_S:
        return None
    times, first = np.unique(stamps_s, return_index=True)
    return Readouts(times, spans_s[first] / span_s)


def stamp(name: str, start_s: float, end_s: float) -> float:
    """Return the timestamp of an image that `shutter_of` refers to."""
    return start_s if name == GLOBAL else (start_s + end_s) / 2


def _lines(width: int, height: int, axis: str) -> int:
    return width if axis == "columns" else height


def parameters_of(model: CameraModel, where: str) -> Any:
    """Return NCore's parameters of a camera. Raises `OutputError` for a lens that NCore has none for."""
    from ncore import data

    lens = model.lens
    shared: dict[str, Any] = {
        "resolution": np.array([model.width, model.height], np.uint64),
        "shutter_type": data.ShutterType[shutter_type(model.shutter)],
        "external_distortion_parameters": None,
    }
    placed: dict[str, Any] = {
        "principal_point": _float32(model.cx, model.cy),
        "focal_length": _float32(model.fx, model.fy),
    }
    if isinstance(lens, Pinhole):
        return data.IdealPinholeCameraModelParameters(**shared, **placed)
    if isinstance(lens, OpenCVPinhole):
        return data.OpenCVPinholeCameraModelParameters(
            **shared,
            **placed,
            radial_coeffs=_float32(lens.k1, lens.k2, lens.k3, lens.k4, lens.k5, lens.k6),
            tangential_coeffs=_float32(lens.p1, lens.p2),
            thin_prism_coeffs=_float32(lens.s1, lens.s2, lens.s3, lens.s4),
        )
    if isinstance(lens, OpenCVFisheye):
        return data.OpenCVFisheyeCameraModelParameters(
            **shared, **placed, radial_coeffs=_float32(lens.k1, lens.k2, lens.k3, lens.k4), max_angle=_reach(model)
        )
    if isinstance(lens, FTheta):
        return _f_theta(model, lens, shared, where)
    raise OutputError(f"{where}: NCore has no lens of the type {lens.TYPE!r}")


def model_of(parameters: Any, where: str) -> CameraModel:
    """Return the camera of NCore's parameters, its shutter left out. Raises `LogError` for one that cannot be modelled."""
    if parameters.external_distortion_parameters is not None:
        raise LogError(f"{where}: stands behind a windshield of its own model, which is not read")
    width, height = (int(x) for x in parameters.resolution)
    kind = parameters.type()
    try:
        if kind == "ftheta":
            focal, f_theta = _read_f_theta(parameters)
            cx, cy = (float(x) + 0.5 for x in parameters.principal_point)
            return CameraModel(width, height, focal, focal, cx, cy, lens=f_theta)
        lens = _read_lens(kind, parameters)
    except LensError as fault:
        raise LogError(f"{where}: {fault}") from fault
    if lens is None:
        raise LogError(f"{where}: has a lens of the type {kind!r:.60}, which is not read")
    fx, fy = (float(x) for x in parameters.focal_length)
    cx, cy = (float(x) for x in parameters.principal_point)
    if not np.isfinite([fx, fy, cx, cy]).all():
        raise LogError(f"{where}: a focal length or principal point is not finite")
    return CameraModel(width, height, fx, fy, cx, cy, lens=lens)


def _read_lens(kind: str, parameters: Any) -> Lens | None:
    if kind == "ideal-pinhole":
        return PINHOLE
    if kind == "opencv-pinhole":
        k = [float(x) for x in parameters.radial_coeffs]
        p = [float(x) for x in parameters.tangential_coeffs]
        s = [float(x) for x in parameters.thin_prism_coeffs]
        return OpenCVPinhole(k[0], k[1], p[0], p[1], *k[2:], *s) if any((*k, *p, *s)) else PINHOLE
    if kind == "opencv-fisheye":
        k = [float(x) for x in parameters.radial_coeffs]
        return OpenCVFisheye(k[0], k[1], k[2], k[3], _degrees(parameters.max_angle))
    return None


def _read_f_theta(parameters: Any) -> tuple[float, FTheta]:
    forward = parameters.reference_poly.name == "ANGLE_TO_PIXELDIST"
    polynomial = parameters.angle_to_pixeldist_poly if forward else parameters.pixeldist_to_angle_poly
    given = [float(x) for x in polynomial]
    while len(given) > 2 and given[-1] == 0:
        given.pop()
    linear = [float(x) for x in parameters.linear_cde]
    return FTheta.from_pixels(given, forward, math.radians(_degrees(parameters.max_angle)), linear)


def _f_theta(model: CameraModel, lens: FTheta, shared: dict[str, Any], where: str) -> Any:
    from ncore import data

    forward = bool(lens.radius_from_angle)
    most = data.FThetaCameraModelParameters.POLYNOMIAL_DEGREE - 1
    count = len(lens.radius_from_angle or lens.angle_from_radius)
    if count > most:
        raise OutputError(f"{where}: NCore's f-theta polynomial has {most} coefficients at most, this one {count}")
    *polynomials, linear = lens.in_pixels(model.fx, model.fy, most)
    names = "angle_to_pixeldist_poly", "pixeldist_to_angle_poly"
    kinds = data.FThetaCameraModelParameters.PolynomialType
    both: dict[str, Any] = {name: _float32(0.0, *x) for name, x in zip(names, polynomials, strict=True)}
    return data.FThetaCameraModelParameters(
        **shared,
        principal_point=_float32(model.cx - 0.5, model.cy - 0.5),
        reference_poly=kinds.ANGLE_TO_PIXELDIST if forward else kinds.PIXELDIST_TO_ANGLE,
        max_angle=_reach(model),
        linear_cde=_float32(*linear),
        **both,
    )


def _reach(model: CameraModel) -> float:
    """The angle from the optical axis that the image reaches: NCore's solvers begin from it, and miss where it is far more."""
    u, v = np.array([0.0, model.width, 0.0, model.width]), np.array([0.0, 0.0, model.height, model.height])
    corners = model.unproject(u, v)
    if not np.isfinite(corners).all():
        return float(model.lens.max_angle_rad)
    return float(np.arctan2(np.hypot(corners[:, 0], corners[:, 1]), corners[:, 2]).max())


def _degrees(angle: float) -> float:
    return min(math.degrees(float(angle)), 180.0)


def _float32(*values: float) -> NDArray[np.float32]:
    return np.array(values, np.float32)
