"""The vehicle's parameters, and how its rear axle lies in the ego frame of a log.

The states of a simulation describe the vehicle by the middle of its rear axle. A log describes it by a frame of its own, x
forward, y left, z up, whose origin is where the log's authors put it: `Vehicle.rear_axle_m` is the rear axle's middle there.
Rotations are those of `geometry.rotation_from_angles`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any, get_origin, get_type_hints

import numpy as np

from ...errors import SimulationError, short
from ...geometry import FloatArray, Vector3, angles_from_rotation, rotation_from_angles
from ...world.drive import EGO
from ..states import EgoState, Footprint
from .actions import check_number

FARTHEST_M = 20.0
"""No rear axle is farther from the origin of its ego frame along an axis."""


@dataclass(frozen=True)
class Vehicle:
    """A passenger car by default: nuPlan's lags and limit of the steering angle, AlpaSim's wheelbase.

    ``rear_overhang_m`` reaches from the rear axle to the rear bumper, ``track_m`` from the left wheels to the right ones.
    ``max_deceleration_m_s2`` is above 0. ``max_lateral_acceleration_m_s2``, 0.8 g by default, is what tyres on a dry road hold:
    a vehicle that is steered more turns no tighter. A lag is the time constant of a first-order lag; 0 is none. Raises
    `SimulationError` for a parameter beyond `LIMITS`, and for axles or wheels beyond the bumpers or the sides.
    """

    wheelbase_m: Annotated[float, (0.5, 20.0)] = 2.85
    track_m: Annotated[float, (0.2, 5.0)] = 1.6
    length_m: Annotated[float, (0.5, 30.0)] = 4.9
    width_m: Annotated[float, (0.2, 5.0)] = 1.9
    rear_overhang_m: Annotated[float, (0.0, 20.0)] = 1.0
    max_steering_rad: Annotated[float, (0.01, 1.4)] = math.pi / 3
    acceleration_lag_s: Annotated[float, (0.0, 10.0)] = 0.2
    steering_lag_s: Annotated[float, (0.0, 10.0)] = 0.05
    max_acceleration_m_s2: Annotated[float, (0.1, 50.0)] = 5.0
    max_deceleration_m_s2: Annotated[float, (0.1, 50.0)] = 9.0
    max_lateral_acceleration_m_s2: Annotated[float, (0.1, 1e4)] = 7.8
    rear_axle_m: Vector3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name, (low, high) in LIMITS.items():
            object.__setattr__(self, name, check_number(getattr(self, name), f"vehicle: {name}", low, high))
        axle = self.rear_axle_m
        if not isinstance(axle, list | tuple) or len(axle) != 3:
            raise SimulationError(f"vehicle: rear_axle_m must be three numbers, not {short(axle)}")
        x, y, z = (check_number(value, "vehicle: rear_axle_m", -FARTHEST_M, FARTHEST_M) for value in axle)
        object.__setattr__(self, "rear_axle_m", (x, y, z))
        if self.length_m < self.wheelbase_m + self.rear_overhang_m:
            raise SimulationError(
                f"vehicle: length_m must be at least wheelbase_m and rear_overhang_m together, "
                f"{self.wheelbase_m + self.rear_overhang_m:g}, not {self.length_m:g}"
            )
        if self.width_m < self.track_m:
            raise SimulationError(f"vehicle: width_m must be at least track_m, {self.track_m:g}, not {self.width_m:g}")

    @property
    def ego_from_axle(self) -> FloatArray:
        """The pose (4, 4) of the rear axle's middle in the log's ego frame."""
        pose = np.eye(4)
        pose[:3, 3] = self.rear_axle_m
        return pose

    def slides(self, steering_rad: float, speed_m_s: float) -> bool:
        """Return whether a steering angle asks for more lateral acceleration than there is."""
        asked = abs(math.tan(steering_rad)) / self.wheelbase_m * speed_m_s**2
        return asked > self.max_lateral_acceleration_m_s2

    def curvature(self, steering_rad: float, speed_m_s: float) -> float:
        """Return the curvature (1/m, left is positive) of the rear axle's path at a steering angle and a speed."""
        if self.slides(steering_rad, speed_m_s):
            return math.copysign(self.max_lateral_acceleration_m_s2 / speed_m_s**2, steering_rad)
        return math.tan(steering_rad) / self.wheelbase_m

    def to_dict(self) -> dict[str, Any]:
        return {**asdict(self), "rear_axle_m": list(self.rear_axle_m)}

    @staticmethod
    def from_dict(values: Any, place: str = "vehicle") -> Vehicle:
        """Return the vehicle of `to_dict`; what is left out has its default. Raises `SimulationError` that names ``place``."""
        if not isinstance(values, dict):
            raise SimulationError(f"{place}: must be an object, not {short(values)}")
        known = [field.name for field in fields(Vehicle)]
        for name in values:
            if name not in known:
                raise SimulationError(f"{place}: has no parameter {short(name)}, only {', '.join(known)}")
        try:
            return Vehicle(**values)
        except SimulationError as fault:
            raise SimulationError(f"{place}{str(fault).removeprefix('vehicle')}") from None


LIMITS: dict[str, tuple[float, float]] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(Vehicle, include_extras=True).items()
    if get_origin(hint) is Annotated
}
"""The least and the largest value of each parameter."""


@dataclass(frozen=True)
class Attitude:
    """Part of the vehicle's pose that is not in the plane: the height of the rear axle's middle (`Vehicle.rear_axle_m`)
    in the world, roll and pitch."""

    z_m: float
    roll_rad: float
    pitch_rad: float


def pose_of(state: EgoState, attitude: Attitude, vehicle: Vehicle) -> FloatArray:
    """Return the pose (4, 4) of the log's ego frame in the world, of a vehicle in this state."""
    return poses_of([state], [attitude], vehicle)[0]


def poses_of(states: Sequence[EgoState], attitudes: Sequence[Attitude], vehicle: Vehicle) -> FloatArray:
    """Return the poses (N, 4, 4) of the log's ego frame in the world, of a vehicle in these states."""
    both = list(zip(states, attitudes, strict=True))
    angles = np.array([(state.heading_rad, how.pitch_rad, how.roll_rad) for state, how in both], np.float64).reshape(
        -1, 3
    )
    poses = np.zeros((len(both), 4, 4))
    poses[:, 3, 3] = 1
    poses[:, :3, :3] = rotation_from_angles(*np.ascontiguousarray(angles.T))
    poses[:, :3, 3] = np.array([(state.x_m, state.y_m, how.z_m) for state, how in both], np.float64).reshape(-1, 3)
    if any(vehicle.rear_axle_m):
        axle = np.array(vehicle.rear_axle_m)
        poses[:, :3, 3] -= [pose[:3, :3] @ axle for pose in poses]
    return poses


def state_of(
    world_from_ego: FloatArray,
    vehicle: Vehicle,
    speed_m_s: float = 0.0,
    acceleration_m_s2: float = 0.0,
    steering_rad: float = 0.0,
) -> tuple[EgoState, Attitude]:
    """Return the state and the attitude of a vehicle whose ego frame has this pose (4, 4): the inverse of `pose_of`."""
    pose = np.asarray(world_from_ego, np.float64)
    x, y, z = (pose[:3, :3] @ np.array(vehicle.rear_axle_m) + pose[:3, 3]).tolist()
    yaw, pitch, roll = (float(angle) for angle in angles_from_rotation(pose[:3, :3]))
    return EgoState(x, y, yaw, speed_m_s, acceleration_m_s2, steering_rad), Attitude(z, roll, pitch)


LABEL = "Car"
"""The ego vehicle's class."""


def footprint_of(state: EgoState, vehicle: Vehicle) -> Footprint:
    """Return the vehicle's box seen from above: its centre lies ahead of the rear axle, by half its length less the rear
    overhang."""
    ahead = vehicle.length_m / 2 - vehicle.rear_overhang_m
    return Footprint(
        uid=EGO,
        label=LABEL,
        x_m=state.x_m + ahead * math.cos(state.heading_rad),
        y_m=state.y_m + ahead * math.sin(state.heading_rad),
        heading_rad=state.heading_rad,
        length_m=vehicle.length_m,
        width_m=vehicle.width_m,
        speed_m_s=state.speed_m_s,
        acceleration_m_s2=state.acceleration_m_s2,
    )
