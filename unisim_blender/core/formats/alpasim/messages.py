"""AlpaSim's compiled messages under the names that the rest of the package uses, and poses, sweeps and cameras as messages.

Poses are float32: 100 m away a place is exact to 8 micrometres. Parameters of cameras are NCore's: pixels are counted from the
corner of the first one, save f-theta's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from carla_driver_interface import protocol
from carla_driver_interface.contract import (
    CONTRACT_REVISION,
    ContractError,
    cameras_to_revision,
    contract_metadata,
    negotiate,
)
from carla_driver_interface.protocol import ALPASIM_API_VERSION as API_VERSION
from carla_driver_interface.protocol import CarlaRendererData as RendererData
from carla_driver_interface.protocol import EgodriverServiceStub as EgodriverStub
from carla_driver_interface.protocol import LidarSweep
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from ...geometry import FloatArray, Trajectory, make_pose, quaternion_from_matrix, transform_points
from ...lenses import PINHOLE
from ...lenses.f_theta import FTheta
from ...lenses.lens import Lens, LensError
from ...lenses.opencv_fisheye import OpenCVFisheye
from ...lenses.opencv_pinhole import OpenCVPinhole
from ...lenses.registry import Pinhole
from ...world.captures import US_PER_SECOND
from ...world.drive import CameraModel, RollingShutter


class FieldError(ValueError):
    """A field of a message that is not valid or cannot be served. ``field`` is its path in the message:
    "dynamic_objects[2].track_id"."""

    def __init__(self, field: str, fault: str) -> None:
        super().__init__(f"{field}: {fault}")
        self.field = field


# the modules themselves, which the package's protocol has, too, but not under its public names
common: Any = protocol.common_pb2  # type: ignore[attr-defined]
egodriver: Any = protocol.egodriver_pb2  # type: ignore[attr-defined]
sensorsim: Any = protocol.sensorsim_pb2  # type: ignore[attr-defined]
__all__ = [
    "API_VERSION",
    "CONTRACT_REVISION",
    "ContractError",
    "DecodeError",
    "EgodriverStub",
    "LidarSweep",
    "RendererData",
    "cameras_to_revision",
    "common",
    "contract_metadata",
    "egodriver",
    "negotiate",
    "sensorsim",
]


def sweep_message(
    name: str, time_us: int, rig_from_lidar: FloatArray, points: FloatArray, intensity: NDArray[np.float32]
) -> Any:
    """Return a sweep's message: ``points`` (N, 3) in the LiDAR's frame at ``time_us``, ``intensity`` (N,) from 0 to 1. The
    message has points in the rig's frame."""
    rows = np.column_stack([transform_points(rig_from_lidar, points), intensity]).astype("<f4")
    return LidarSweep(
        logical_id=name,
        timestamp_us=time_us,
        rig_to_lidar=pose_message(rig_from_lidar),
        num_points=len(rows),
        points_xyzi=rows.tobytes(),
    )


FARTHEST_M = 1e6
"""No pose is farther from the world's origin along an axis."""


def vector_message(vector: Iterable[float]) -> Any:
    """Return the message of x, y and z."""
    x, y, z = (float(value) for value in vector)
    return common.Vec3(x=x, y=y, z=z)


def pose_message(pose: FloatArray) -> Any:
    """Return the message of a pose (4, 4)."""
    w, x, y, z = quaternion_from_matrix(pose[:3, :3]).tolist()
    return common.Pose(vec=vector_message(pose[:3, 3]), quat=common.Quat(w=w, x=x, y=y, z=z))


def trajectory_message(times_us: Iterable[int], poses: Iterable[FloatArray]) -> Any:
    """Return the message of poses (4, 4) at times, integer microseconds."""
    keys = zip(times_us, poses, strict=True)
    return common.Trajectory(
        poses=[common.PoseAtTime(pose=pose_message(pose), timestamp_us=time_us) for time_us, pose in keys]
    )


def pose_of(message: Any, field: str) -> FloatArray:
    """Return the pose (4, 4) of a message. Raises `FieldError` where a number is not finite or the quaternion has no length."""
    vec, quat = message.vec, message.quat
    position = np.array([vec.x, vec.y, vec.z], np.float64)
    quaternion = np.array([quat.w, quat.x, quat.y, quat.z], np.float64)
    if not np.isfinite(position).all() or np.abs(position).max() > FARTHEST_M:
        raise FieldError(f"{field}.vec", f"must be finite numbers of at most {FARTHEST_M:g} m, not {position.tolist()}")
    length = float(np.linalg.norm(quaternion))
    if not math.isfinite(length) or abs(length - 1) > 1e-2:
        raise FieldError(f"{field}.quat", f"must be a unit quaternion, not {quaternion.tolist()}")
    return make_pose(position, quaternion / length)


def pair_trajectory(message: Any, start_us: int, end_us: int, field: str) -> Trajectory:
    """Return the trajectory of a pair of poses at the start and the end of a frame; of the start alone where a frame takes no
    time. Raises `FieldError`."""
    for name in ("start_pose", "end_pose"):
        if not message.HasField(name):
            raise FieldError(f"{field}.{name}", "is missing")
    poses = np.stack([pose_of(getattr(message, name), f"{field}.{name}") for name in ("start_pose", "end_pose")])
    times = np.array([start_us, end_us]) / 1e6
    return Trajectory.from_poses(times, poses) if end_us > start_us else Trajectory.from_poses(times[:1], poses[:1])


COEFFICIENTS = 6
"""Of the f-theta polynomial that a lens does not have itself."""
MOST_PIXELS = 1 << 24
"""Width times height of an image."""
LEAST_FOCAL = 1e-2
"""Least focal length in pixels."""
SHUTTERS = {
    "ROLLING_TOP_TO_BOTTOM": ("rows", False),
    "ROLLING_BOTTOM_TO_TOP": ("rows", True),
    "ROLLING_LEFT_TO_RIGHT": ("columns", False),
    "ROLLING_RIGHT_TO_LEFT": ("columns", True),
}
"""AlpaSim's shutters: which lines are exposed one after the other, and whether the last one is first."""
LENSES = ("opencv_pinhole_param", "opencv_fisheye_param", "ftheta_param")


def camera_message(name: str, model: CameraModel) -> Any:
    """Return the message of a camera. Raises `FieldError` for a lens that AlpaSim has none for."""
    spec = sensorsim.CameraSpec(logical_id=name, resolution_w=model.width, resolution_h=model.height)
    spec.shutter_type = sensorsim.ShutterType.Value(shutter_name(model.shutter))
    lens = model.lens
    if isinstance(lens, Pinhole | OpenCVPinhole):
        pinhole = spec.opencv_pinhole_param
        pinhole.principal_point_x, pinhole.principal_point_y = model.cx, model.cy
        pinhole.focal_length_x, pinhole.focal_length_y = model.fx, model.fy
        if isinstance(lens, OpenCVPinhole):
            pinhole.radial_coeffs.extend([lens.k1, lens.k2, lens.k3, lens.k4, lens.k5, lens.k6])
            pinhole.tangential_coeffs.extend([lens.p1, lens.p2])
            pinhole.thin_prism_coeffs.extend([lens.s1, lens.s2, lens.s3, lens.s4])
    elif isinstance(lens, OpenCVFisheye):
        fisheye = spec.opencv_fisheye_param
        fisheye.principal_point_x, fisheye.principal_point_y = model.cx, model.cy
        fisheye.focal_length_x, fisheye.focal_length_y = model.fx, model.fy
        fisheye.radial_coeffs.extend([lens.k1, lens.k2, lens.k3, lens.k4])
        fisheye.max_angle = lens.max_angle_rad
    elif isinstance(lens, FTheta):
        to_pixels, to_angle, (c, d, e) = lens.in_pixels(model.fx, model.fy, COEFFICIENTS)
        theta = spec.ftheta_param
        theta.principal_point_x, theta.principal_point_y = model.cx - 0.5, model.cy - 0.5
        theta.angle_to_pixeldist_poly.extend([0.0, *to_pixels.tolist()])
        theta.pixeldist_to_angle_poly.extend([0.0, *to_angle.tolist()])
        kind = "ANGLE_TO_PIXELDIST" if lens.radius_from_angle else "PIXELDIST_TO_ANGLE"
        theta.reference_poly = theta.PolynomialType.Value(kind)
        theta.max_angle = lens.max_angle_rad
        theta.linear_cde.linear_c, theta.linear_cde.linear_d, theta.linear_cde.linear_e = c, d, e
    else:
        raise FieldError(f"camera {name!r}", f"AlpaSim has no lens of the type {lens.TYPE!r}")
    return spec


def shutter_name(shutter: RollingShutter) -> str:
    """Return AlpaSim's name of a shutter."""
    kind = (shutter.axis, shutter.duration_s < 0)
    return "GLOBAL" if shutter.duration_s == 0 else next(name for name, known in SHUTTERS.items() if known == kind)


def model_of(spec: Any, width: int, height: int, start_us: int, end_us: int, field: str) -> tuple[CameraModel, int]:
    """Return the camera of a message, with images of this size, and their timestamp: the middle of the exposure from
    ``start_us`` to ``end_us``.

    Images that are larger or smaller than the lens's own resolution show the same: its numbers are scaled. Raises `FieldError`,
    also for another ratio of width and height, which would be a crop or a stretch: the messages do not say which. (AlpaSim's
    runtime sends the recorded lens with the size that its configuration has for the camera.)
    """
    own = spec.resolution_w, spec.resolution_h
    at = field.rpartition(".")[0]
    at = f"{at}." if at else ""
    for name, size, was in (("resolution_w", width, own[0]), ("resolution_h", height, own[1])):
        if not 1 <= size <= MOST_PIXELS:
            raise FieldError(f"{at}{name}", f"must be 1 or more, not {size}")
        if not 1 <= was <= MOST_PIXELS:
            raise FieldError(f"{field}.{name}", f"must be the lens's own size in pixels, 1 or more, not {was}")
    if width * height > MOST_PIXELS:
        raise FieldError(f"{at}resolution_w", f"{width} x {height} pixels are more than {MOST_PIXELS}")
    if abs(width * own[1] - height * own[0]) > max(own):
        raise FieldError(
            f"{at}resolution_w",
            f"{width} x {height} pixels have another ratio than the lens's {own[0]} x {own[1]}: it would be stretched",
        )
    if spec.HasField("bivariate_windshield_model_param"):
        raise FieldError(f"{field}.bivariate_windshield_model_param", "windshields are not modelled")
    kind = next((name for name in LENSES if spec.HasField(name)), None)
    if kind is None:
        raise FieldError(field, f"needs one of {', '.join(LENSES)}")
    try:
        model = _model(kind, getattr(spec, kind), *own, f"{field}.{kind}")
    except LensError as fault:
        raise FieldError(f"{field}.{kind}", str(fault)) from fault
    if model.cx == model.cy == 0 or (kind == "ftheta_param" and model.cx == model.cy == 0.5):
        raise FieldError(f"{field}.{kind}.principal_point_x", "no principal point is given: it is 0, 0")
    numbers = model.fx, model.fy, abs(model.cx), abs(model.cy)
    if min(numbers[:2]) < LEAST_FOCAL or max(numbers) > MOST_PIXELS:
        raise FieldError(
            f"{field}.{kind}",
            f"focal lengths from {LEAST_FOCAL:g} and all numbers up to {MOST_PIXELS} pixels are served, not "
            f"{', '.join(f'{number:g}' for number in numbers)}",
        )
    sx, sy = width / own[0], height / own[1]
    model = replace(
        model, width=width, height=height, fx=model.fx * sx, fy=model.fy * sy, cx=model.cx * sx, cy=model.cy * sy
    )
    time_us = (start_us + end_us) // 2
    name = sensorsim.ShutterType.Name(spec.shutter_type) if spec.shutter_type in sensorsim.ShutterType.values() else "?"
    if name in SHUTTERS:
        axis, reverse = SHUTTERS[name]
        taken_us, seconds = end_us - start_us, (end_us - start_us) / US_PER_SECOND
        middle = (time_us - start_us) / taken_us if taken_us else 0.5
        shutter = RollingShutter(-seconds, 1 - middle, axis) if reverse else RollingShutter(seconds, middle, axis)
        return replace(model, shutter=shutter), time_us
    if name != "GLOBAL":
        raise FieldError(f"{field}.shutter_type", f"must be GLOBAL or one of {', '.join(SHUTTERS)}")
    return model, time_us


def _model(kind: str, message: Any, width: int, height: int, field: str) -> CameraModel:
    if kind == "ftheta_param":
        return _f_theta(message, width, height, field)
    lens: Lens
    if kind == "opencv_pinhole_param":
        k = _numbers(message.radial_coeffs, 6, f"{field}.radial_coeffs")
        p = _numbers(message.tangential_coeffs, 2, f"{field}.tangential_coeffs")
        s = _numbers(message.thin_prism_coeffs, 4, f"{field}.thin_prism_coeffs")
        lens = OpenCVPinhole(k[0], k[1], *p, *k[2:], *s) if any((*k, *p, *s)) else PINHOLE
    else:
        k = _numbers(message.radial_coeffs, 4, f"{field}.radial_coeffs")
        degrees = min(math.degrees(message.max_angle), 180.0) if message.max_angle else 180.0
        lens = OpenCVFisheye(k[0], k[1], k[2], k[3], degrees)
    fx, fy = message.focal_length_x, message.focal_length_y
    return CameraModel(width, height, fx, fy, message.principal_point_x, message.principal_point_y, lens=lens)


def _f_theta(message: Any, width: int, height: int, field: str) -> CameraModel:
    kinds = {
        message.PolynomialType.Value("ANGLE_TO_PIXELDIST"): "angle_to_pixeldist_poly",
        message.PolynomialType.Value("PIXELDIST_TO_ANGLE"): "pixeldist_to_angle_poly",
    }
    if message.reference_poly not in kinds:
        raise FieldError(f"{field}.reference_poly", "must be ANGLE_TO_PIXELDIST or PIXELDIST_TO_ANGLE")
    name = kinds[message.reference_poly]
    polynomial = list(getattr(message, name))
    while len(polynomial) > 2 and polynomial[-1] == 0:
        polynomial.pop()
    cde = message.linear_cde
    linear = (cde.linear_c, cde.linear_d, cde.linear_e) if message.HasField("linear_cde") else (1.0, 0.0, 0.0)
    reach = message.max_angle or math.pi
    focal, lens = FTheta.from_pixels(polynomial, name == "angle_to_pixeldist_poly", reach, linear)
    cx, cy = message.principal_point_x + 0.5, message.principal_point_y + 0.5
    return CameraModel(width, height, focal, focal, cx, cy, lens=lens)


def _numbers(values: Any, most: int, field: str) -> list[float]:
    """Return coefficients, 0 for those that are left out."""
    numbers = [float(value) for value in values]
    if len(numbers) > most:
        raise FieldError(field, f"must be at most {most} numbers, not {len(numbers)}")
    return numbers + [0.0] * (most - len(numbers))
