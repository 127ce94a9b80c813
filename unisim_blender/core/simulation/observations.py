"""Observations of a driver: sensors' data, its vehicle's motion, and its route. Neither boxes nor the scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..output.frame_files import POINT_FIELDS as FIELDS
from ..world.drive import CameraModel, LidarModel
from .actors.recording import Recording
from .states import EgoState, Traffic
from .vehicle.parameters import Vehicle

POINT_FIELDS = np.dtype([(name, FIELDS[name]) for name in FIELDS.names or () if name != "instance"])
"""As in the files of sweeps (`output.frame_files.POINT_FIELDS`), without the instances."""


@dataclass(frozen=True, eq=False)
class CameraImage:
    """A camera's image: ``rgb`` (H, W, 3) uint8, sRGB, row 0 at the top. ``time_us`` is its timestamp, ``start_us`` and
    ``end_us`` are when its exposure started and ended, integer microseconds from the log's first frame."""

    sensor_id: str
    time_us: int
    start_us: int
    end_us: int
    rgb: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class LidarSweep:
    """A LiDAR's returns; times as of an `CameraImage`.

    ``points`` are records (N,) of `POINT_FIELDS`, for example ``points["x"]``: ``x``, ``y``, ``z`` (m) in the LiDAR's frame at
    ``time_us``, `SensorSetup.rear_axle_from_sensor` places it on the vehicle; ``intensity``, 0 to 1; ``ring``, the beam;
    ``azimuth`` (rad) and ``time`` (s from the log's first frame) of firing.
    """

    sensor_id: str
    time_us: int
    start_us: int
    end_us: int
    points: NDArray[np.void]


@dataclass(frozen=True)
class EgoMotion:
    """The vehicle's state at a time, as its own sensors measure it: without error."""

    time_us: int
    state: EgoState


@dataclass(frozen=True, eq=False)
class SensorSetup:
    """A sensor as the driver knows it: its model, and its pose (4, 4) in the rear axle's frame (x forward, y left, z up)."""

    model: CameraModel | LidarModel
    rear_axle_from_sensor: FloatArray


@dataclass(frozen=True, eq=False)
class DriverSetup:
    """Information that a driver has before it drives: its vehicle, its sensors by name, a step's length and its
    answers' delay (integer microseconds), and a seed.

    ``route`` (P, 2) are points on the way in order, world frame, metres: the recorded path, without times.
    ``rear_axle_height_m``: how high the middle of the rear axle, as the log's ego frame has it, lies above the ground where the
    drive starts. ``history`` are the vehicle's recorded states of up to 2 s before the start, a step apart; none where the
    recording begins there, or the vehicle starts elsewhere than it was recorded."""

    vehicle: Vehicle
    sensors: Mapping[str, SensorSetup]
    route: FloatArray
    step_us: int
    delay_us: int
    seed: int
    rear_axle_height_m: float = 0.0
    history: tuple[EgoMotion, ...] = ()
    recording: Recording | None = field(default=None, repr=False)
    """For privileged drivers alone."""


@dataclass(frozen=True, eq=False)
class Observation:
    """Data for a driver at ``time_us``: all delivered since it was asked last, in the order in which exposures ended.

    ``motion`` has the vehicle's states since then, the last one of now. ``traffic`` is there for privileged drivers alone.
    """

    time_us: int
    images: tuple[CameraImage, ...]
    sweeps: tuple[LidarSweep, ...]
    motion: tuple[EgoMotion, ...]
    traffic: Traffic | None = field(default=None, repr=False)

    @property
    def ego(self) -> EgoState:
        """The vehicle's state now."""
        return self.motion[-1].state
