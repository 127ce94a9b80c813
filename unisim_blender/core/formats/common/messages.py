"""Messages of a run, independent of a format, and their order.

Times: integer nanoseconds. World, boxes and sensors: axes as in `world.drive`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...json_file import Node
from ...lenses.opencv_fisheye import OpenCVFisheye
from ...lenses.opencv_pinhole import OpenCVPinhole
from ...world.drive import EGO, CameraModel, Drive


class Run(Protocol):
    """A finished run that formats are written of; `export.finished_run.FinishedRun` is one.

    ``drive``: what was rendered, its cameras at the size of the images. ``shift_ns``: what is added to all times.
    """

    drive: Drive
    shift_ns: int

    def about(self) -> dict[str, str]:
        """Return the metadata that messages do not have, as texts by name."""

    def name_of(self, image: ImageMessage) -> str:
        """Return the name of an image in files that refer to it."""

    def messages(self) -> Iterator[Message]:
        """Yield everything in the order of time. Raises `LogError` and `OutputError` for files that are missing or
        broken."""

    def images(self) -> Iterator[tuple[ImageMessage, Node]]:
        """Yield all images in the order of time, each with its boxes' poses in its camera's frame, by actor. Raises as
        `messages`."""


@dataclass(frozen=True)
class RunFormat:
    """A format of a whole run, as --format has it.

    ``output`` is what it writes, below the run's folder. ``modules`` are imported before anything is rendered, so that
    a missing package is told at once. ``needs`` are the formats of frames that it is made of. ``write`` writes a run to
    a path: all of it, or nothing; equal runs give equal bytes. It raises `UnisimError`.
    """

    name: str
    output: str
    modules: tuple[str, ...]
    needs: tuple[str, ...]
    write: Callable[[Run, Path], None]


PLUMB_BOB, RATIONAL, FISHEYE = "plumb_bob", "rational_polynomial", "equidistant"
"""ROS's names of OpenCV's distortions; Foxglove calls the last one kannala_brandt."""


@dataclass(frozen=True)
class OpenCVCalibration:
    """``matrix``: K, row by row, with pixel centres at whole numbers, as OpenCV and ROS have them. ``coefficients`` are
    in the order of ``distortion``; other lenses have their own name there, and none."""

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


SECOND_NS = 1_000_000_000
WORLD, REAR_AXLE = "world", "rear_axle"
"""Frames of reference beside `EGO`, the vehicle's; a sensor's is its name."""
TRANSFORMS, MOUNTS, BOXES, EGO_STATE, EGO_PLAN = "/tf", "/tf_static", "/boxes", "/ego/state", "/ego/plan"
"""Topics of messages that belong to no sensor."""

POINT_FIELDS = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<i4"), ("instance", "<i4"),
        ("time", "<f8"),
    ]
)  # fmt: skip
"""Fields of a point as in a sweep's own files, but ``instance`` counts in the whole run's list
(`FinishedRun.instances`)."""


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
    """Mounts of the sensors that ride on the vehicle, from ``time_ns`` on: poses in the frame EGO by sensor."""

    time_ns: int
    poses: Mapping[str, Pose]


@dataclass(frozen=True)
class RolloutEgo:
    """The vehicle of a rollout, by the middle of its rear axle, at the end of a step. ``speed_m_s`` is along its
    heading, ``yaw_rate_rad_s`` counter-clockwise."""

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
    """An image's file, and the camera that took it. ``moved`` names the frame of reference that moves with the image,
    EGO where the camera rides on the vehicle, else the camera's own, and its pose then."""

    time_ns: int
    sensor_id: str
    pose: Pose
    moved: tuple[str, Pose]
    path: Path
    model: CameraModel


@dataclass(frozen=True)
class SweepMessage:
    """A sweep's returns: records of `POINT_FIELDS` in the sensor's frame, which lies at ``pose``; ``moved`` as of an
    image."""

    time_ns: int
    sensor_id: str
    pose: Pose
    moved: tuple[str, Pose]
    points: NDArray[np.void] = field(repr=False)


Message = Mounts | BoxLabels | RolloutEgo | PlannedPoses | ImageMessage | SweepMessage

MOVING, STANDING = (0.95, 0.55, 0.1, 0.4), (0.3, 0.55, 0.95, 0.4)
"""Colours (red, green, blue, opacity) that boxes are drawn with."""


def colour_of(box: LabelledBox) -> tuple[float, float, float, float]:
    """Return the colour that a box is drawn with."""
    return MOVING if box.moves else STANDING


def point_layout() -> Iterator[tuple[str, str, int]]:
    """Yield the fields of `POINT_FIELDS`: their names, numpy's names of their types, and their offsets in bytes."""
    for name, entry in (POINT_FIELDS.fields or {}).items():
        yield name, entry[0].str, entry[1]


class MessageEncoder(ABC):
    """Encodes a run's messages as those of a library, with their topics."""

    camera_info: str
    """The end of the topic of cameras' calibration, after the camera's own part; ``image`` is that of images."""
    image: str

    def encode(self, message: Message) -> Iterator[tuple[str, Any]]:
        """Yield topics and the library's messages of a message of a run."""
        time_ns = message.time_ns
        if isinstance(message, Mounts):
            yield MOUNTS, self.transforms(time_ns, message.poses, EGO)
        elif isinstance(message, BoxLabels):
            placed = {EGO: message.ego, **{f"actor/{box.uid}": box.pose for box in message.boxes}}
            yield TRANSFORMS, self.transforms(time_ns, placed)
            yield BOXES, self.boxes(time_ns, message.boxes)
        elif isinstance(message, ImageMessage):
            yield TRANSFORMS, self.transforms(time_ns, dict([message.moved]))
            topic = self.topic("camera", message.sensor_id)
            yield f"{topic}/{self.camera_info}", self.calibration(message, calibration_of(message.model))
            yield f"{topic}/{self.image}", self.compressed_image(message)
        elif isinstance(message, SweepMessage):
            yield TRANSFORMS, self.transforms(time_ns, dict([message.moved]))
            yield f"{self.topic('lidar', message.sensor_id)}/points", self.point_cloud(message)
        elif isinstance(message, RolloutEgo):
            yield TRANSFORMS, self.transforms(time_ns, {REAR_AXLE: message.pose})
            yield EGO_STATE, self.odometry(message)
        else:
            yield EGO_PLAN, self.path(message)

    def topic(self, kind: str, sensor_id: str) -> str:
        """Return the beginning of a sensor's topics; ``kind`` is "camera" or "lidar"."""
        return f"/{kind}/{sensor_id}"

    @abstractmethod
    def transforms(self, time_ns: int, poses: Mapping[str, Pose], parent: str = WORLD) -> Any:
        """Return frames of reference by their names, at their poses in the frame ``parent``."""

    @abstractmethod
    def boxes(self, time_ns: int, boxes: Sequence[LabelledBox]) -> Any:
        """Return all boxes that there are; a box that is not named again is gone."""

    @abstractmethod
    def calibration(self, message: ImageMessage, calibration: OpenCVCalibration) -> Any:
        """Return the calibration of an image's camera."""

    @abstractmethod
    def compressed_image(self, message: ImageMessage) -> Any:
        """Return an image, as its file has it."""

    @abstractmethod
    def point_cloud(self, message: SweepMessage) -> Any:
        """Return a sweep."""

    @abstractmethod
    def odometry(self, message: RolloutEgo) -> Any:
        """Return the state of a rollout's vehicle."""

    @abstractmethod
    def path(self, message: PlannedPoses) -> Any:
        """Return a driver's plan."""
