"""The reference points of OpenSCENARIO's entities."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ...geometry import FloatArray, angles_from_rotation, rotation_from_angles
from ...world.drive import EGO, Actor

Place = tuple[float, float, float, float, float, float]
"""x, y, z in metres and heading, pitch, roll in radians."""
EGO_NAMES = (EGO, "Ego", "EGO", "hero", "Hero")
"""Names of the entity that stands for the recording vehicle."""
REAR_OVERHANG = 0.2
"""Of a vehicle's length: how far its rear axle is from its rear bumper. No log says it."""


class EgoVehicle(Protocol):
    """The ego vehicle, as the caller states it: sizes in metres; ``ego_from_axle`` (4, 4) is the pose of its rear axle's middle
    in the log's ego frame. `simulation.vehicle.parameters.Vehicle` is one."""

    @property
    def length_m(self) -> float: ...
    @property
    def width_m(self) -> float: ...
    @property
    def wheelbase_m(self) -> float: ...
    @property
    def rear_overhang_m(self) -> float: ...
    @property
    def ego_from_axle(self) -> FloatArray: ...


def box_centre(actor: Actor, is_vehicle: bool) -> tuple[float, float, float]:
    """Return the middle of an actor's box as its reference point sees it."""
    length, _, height = actor.size_m.tolist()
    return (length * (0.5 - REAR_OVERHANG) if is_vehicle else 0.0), 0.0, height / 2


def ego_centre(vehicle: EgoVehicle, height_m: float) -> tuple[float, float, float]:
    """Return the middle of the ego vehicle's box as its reference point sees it."""
    return vehicle.length_m / 2 - vehicle.rear_overhang_m, 0.0, height_m / 2


def shifted(offset: tuple[float, float, float]) -> FloatArray:
    """Return the pose (4, 4) of a point at an offset."""
    pose = np.eye(4)
    pose[:3, 3] = offset
    return pose


def place_of(pose: FloatArray) -> Place:
    """Return x, y, z and heading, pitch, roll of a pose (4, 4), in the order of `WorldPosition`'s attributes x to r."""
    yaw, pitch, roll = (float(one) for one in angles_from_rotation(pose[:3, :3]))
    x, y, z = pose[:3, 3].tolist()
    return x, y, z, yaw, pitch, roll


def pose_at(place: Place) -> FloatArray:
    """Return the pose (4, 4) of `place_of`."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_angles(*(np.asarray(angle, np.float64) for angle in place[3:]))
    pose[:3, 3] = place[:3]
    return pose
