"""What a run consists of, in no format yet. Times: integer nanoseconds. World, boxes and sensors: axes as in `world.drive`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...world.drive import CameraModel

SECOND_NS = 1_000_000_000
WORLD, EGO, REAR_AXLE = "world", "ego", "rear_axle"
"""Frames of reference; a sensor's is its name."""

POINT_FIELDS = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<i4"), ("instance", "<i4"),
        ("time", "<f8"),
    ]
)  # fmt: skip
"""As in a sweep's own files, but that ``instance`` counts in the whole run's list (`FinishedRun.instances`)."""


@dataclass(frozen=True)
class Pose:
    """A pose in the world: ``position`` in metres, and a unit quaternion wxyz."""

    position: tuple[float, float, float]
    quaternion_wxyz: tuple[float, float, float, float]


@dataclass(frozen=True)
class LabelledBox:
    """A box: the pose of its centre, its size along its own axes, and what labels say of it (``notes``)."""

    uid: str
    label: str
    pose: Pose
    size_m: tuple[float, float, float]
    moves: bool
    notes: Mapping[str, str]


@dataclass(frozen=True)
class BoxLabels:
    """The labels of a moment: the ego vehicle's pose and all boxes."""

    time_ns: int
    ego: Pose
    boxes: tuple[LabelledBox, ...]


@dataclass(frozen=True)
class Mounts:
    """Where sensors sit on the vehicle, poses in the frame EGO by sensor, from ``time_ns`` on: of those that ride on it."""

    time_ns: int
    poses: Mapping[str, Pose]


@dataclass(frozen=True)
class RolloutEgo:
    """The vehicle of a rollout, by the middle of its rear axle, at the end of a step. ``speed_m_s`` is along its heading,
    ``yaw_rate_rad_s`` counter-clockwise."""

    time_ns: int
    pose: Pose
    speed_m_s: float
    yaw_rate_rad_s: float
    acceleration_m_s2: float
    steering_rad: float


@dataclass(frozen=True)
class PlannedPoses:
    """A driver's plan, answered at ``time_ns``: where the middle of the rear axle is to be at ``times_ns``."""

    time_ns: int
    times_ns: tuple[int, ...]
    poses: tuple[Pose, ...]


@dataclass(frozen=True)
class ImageMessage:
    """An image's file, and the camera that took it. ``moved`` names the frame of reference that moves with the image, EGO where
    the camera rides on the vehicle, else the camera's own, and its pose then."""

    time_ns: int
    sensor_id: str
    pose: Pose
    moved: tuple[str, Pose]
    path: Path
    model: CameraModel


@dataclass(frozen=True)
class SweepMessage:
    """A sweep's returns: records of `POINT_FIELDS` in the sensor's frame, which lies at ``pose``; ``moved`` as of an image."""

    time_ns: int
    sensor_id: str
    pose: Pose
    moved: tuple[str, Pose]
    points: NDArray[np.void] = field(repr=False)


Message = Mounts | BoxLabels | RolloutEgo | PlannedPoses | ImageMessage | SweepMessage

MOVING, STANDING = (0.95, 0.55, 0.1, 0.4), (0.3, 0.55, 0.95, 0.4)
"""Colours (red, green, blue, opacity) that boxes are drawn with."""


def frame_of(box: LabelledBox) -> str:
    """Return the name of a box's own frame of reference."""
    return f"actor/{box.uid}"


def colour_of(box: LabelledBox) -> tuple[float, float, float, float]:
    """Return the colour that a box is drawn with."""
    return MOVING if box.moves else STANDING
