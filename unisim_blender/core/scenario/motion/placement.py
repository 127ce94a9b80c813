"""Poses as a scenario writes them: a position, and angles or a quaternion; boxes of space; the matrices
that they stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...geometry import FloatArray, Quaternion, Vector3, make_pose, quaternion_from_yaw, quaternion_product
from ..checks import require
from ..json_schema import POSITIVE, Schema, SchemaOf, numbers, object_of

QUATERNION_LENGTH_TOLERANCE = 1e-3
"""Largest deviation of a quaternion's length from 1, for those written by hand."""
UNIT_LENGTH_TOLERANCE = 1e-12
"""Lengths this near to 1 are unit length."""


@dataclass(frozen=True, kw_only=True)
class Rotation:
    """Yaw, pitch and roll in degrees, or a unit quaternion."""

    yaw_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    quaternion_wxyz: Quaternion | None = None


@dataclass(frozen=True, kw_only=True)
class Placement(Rotation):
    """A pose: in the world for boxes, on the ego vehicle for sensors."""

    position: Vector3


@dataclass(frozen=True, kw_only=True)
class Offset(Rotation):
    """Offset of a sensor's mount: a rotation and a translation."""

    position: Vector3 | None = None


@dataclass(frozen=True, kw_only=True)
class BoxSpec(Placement):
    """A box of space: its centre's pose and its edges."""

    size_m: Annotated[Vector3, SchemaOf(numbers(3, POSITIVE))]


DEFS: dict[str, Schema] = {
    "placement": object_of(
        Placement,
        "A pose: position, and yaw (counter-clockwise), pitch (up) and roll (to the right) or a unit quaternion.",
    ),
    "box": object_of(BoxSpec),
    "mount_offset": object_of(Offset, "Moved along the ego vehicle's axes and turned about the sensor itself."),
}


def check_rotation(rotation: Rotation, place: str) -> None:
    """Raise `ScenarioError` for a rotation given twice and for a quaternion whose length is not 1."""
    angles = (rotation.yaw_deg, rotation.pitch_deg, rotation.roll_deg)
    if rotation.quaternion_wxyz is None:
        return
    require(angles == (None, None, None), place, "has angles beside quaternion_wxyz, which exclude each other")
    length = float(np.linalg.norm(rotation.quaternion_wxyz))
    require(
        abs(length - 1) <= QUATERNION_LENGTH_TOLERANCE,
        f"{place}.quaternion_wxyz",
        f"{list(rotation.quaternion_wxyz)} has length {length:.6g}, not 1",
    )


def rotation_of(rotation: Rotation) -> FloatArray:
    """Quaternion wxyz (4,): yaw counter-clockwise about z, then pitch with the front up, then roll to the right."""
    if rotation.quaternion_wxyz is not None:
        return unit_quaternions(np.array([rotation.quaternion_wxyz], float))[0]
    yaw, pitch, roll = (np.radians(angle or 0.0) for angle in (rotation.yaw_deg, rotation.pitch_deg, rotation.roll_deg))
    about_y = np.array(
        [np.cos(pitch / 2), 0.0, -np.sin(pitch / 2), 0.0]
    )  # y points left: turning about it lowers the front
    about_x = np.array([np.cos(roll / 2), np.sin(roll / 2), 0.0, 0.0])
    return quaternion_product(quaternion_product(quaternion_from_yaw(yaw), about_y), about_x)


def rotations_of(rotations: Sequence[Rotation]) -> FloatArray:
    """Quaternions wxyz (N, 4), see `rotation_of`."""
    stated = [rotation.quaternion_wxyz for rotation in rotations]
    if None in stated:
        return np.stack([rotation_of(rotation) for rotation in rotations])
    return unit_quaternions(np.array(stated, float))


def unit_quaternions(quaternions_wxyz: FloatArray) -> FloatArray:
    """Normalise quaternions (N, 4), each independently of the others. One of unit length within `UNIT_LENGTH_TOLERANCE`
    is returned as it is, so that a pose copied from a drive into a scenario keeps its bits."""
    norms = np.sqrt((quaternions_wxyz * quaternions_wxyz).sum(-1, keepdims=True))
    return np.where(np.abs(norms - 1) > UNIT_LENGTH_TOLERANCE, quaternions_wxyz / norms, quaternions_wxyz)


def pose_of(placement: Placement) -> FloatArray:
    """Return the placement as a pose (4, 4)."""
    return make_pose(np.array(placement.position, float), rotation_of(placement))
